"""Walking: load of a stride, share of the moment that the actuator carries."""
