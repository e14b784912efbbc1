"""Start the graph from plain Python: the child processes, and their supervision by the launch scripts."""
