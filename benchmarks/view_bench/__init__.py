"""Of benchmarks/view.py: what ``palp view`` costs a graph, and how soon it shows and stops."""
