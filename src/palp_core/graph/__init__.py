"""A node graph for anybody: messages, nodes, launch files, swap, bags; it knows nothing of palpation."""
