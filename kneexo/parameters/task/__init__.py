"""What the knee shall do and what happens to it: reference, push, fault, gait."""
