"""The command line, one file for each command or family of commands.

A command first checks its arguments, by code that imports in no time: given files, numbers with units, names. Then it
imports the work, which takes seconds.
"""
