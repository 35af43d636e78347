"""The files that kneexo reads and writes for a user.

`diagramc.output_directory` writes all files of a result or none.

- `reading` reads bytes and text of a bounded size.
- `table` reads columns of numbers from a CSV file.
- `locking` extends a file that other processes may not open meanwhile.
"""
