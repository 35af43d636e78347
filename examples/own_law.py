"""Put a control law of your own in place of ours; the argument names choose what it gets."""

import kneexo as kx


def law(rod_extension, rod_reference, gain=1.3e5):
    """Return the motor speed in rad/s; a positive speed drives the rod out."""
    return gain * (rod_reference[0] - rod_extension)


if __name__ == "__main__":
    print(kx.track(law=law).metrics)
    print(kx.linearize(law=law))
