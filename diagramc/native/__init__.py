"""Compiles equations to machine code, keeps the code on disk, and runs it."""
