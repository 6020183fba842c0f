"""A session as others want it: tidy tables with a data dictionary, in the formats of other tools."""
