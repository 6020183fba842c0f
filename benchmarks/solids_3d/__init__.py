"""A ball pressed into gel, by finite elements in three dimensions: what judges the contact models."""
