"""Starting the graph from plain Python: the processes, and what a launch script does with them."""
