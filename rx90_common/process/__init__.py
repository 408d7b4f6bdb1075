"""Functions for processes: interrupts, standard output, files, child processes, packages that are missing."""
