"""What a page shows, as plain data without any page: of a running graph, a bag, a results folder."""
