"""The command line, one file for each command or family of commands.

A command first checks its arguments, with what takes no time to import: files that are given, numbers with units,
names. Then it imports the work, which takes seconds.
"""
