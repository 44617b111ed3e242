"""How long work runs: worker processes, threads, progress, interruptions and signals."""
