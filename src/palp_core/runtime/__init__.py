"""The node graph's runtime: messages, ports, nodes, clocks, executors and buses."""
