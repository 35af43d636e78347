"""The device: plant, linkages, sensors and controllers, bus, protection."""
