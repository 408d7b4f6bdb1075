"""What a process needs: interrupts, standard output, files, child processes."""
