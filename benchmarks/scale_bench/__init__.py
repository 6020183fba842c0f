"""Many small nodes: what a graph of them costs while next to nothing happens."""
