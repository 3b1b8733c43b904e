"""The command line: one module a command; each parses, calls, prints and sets the exit code, nothing else."""
