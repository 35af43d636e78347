"""The wearer coupled to the device: impedance, passivity, torque bandwidth."""
