"""Data for the pages, without any page: of a running graph or a bag."""
