"""The files that kneexo reads and writes for a user.

- `reading` reads bytes and text of a bounded size.
- `table` reads columns of numbers from a CSV file.
- `writing` writes all files of a result or none.
- `locking` locks files against other processes.
"""
