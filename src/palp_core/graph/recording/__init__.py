"""Recording a graph while it runs."""
