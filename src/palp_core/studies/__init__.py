"""What is made of the rig's records: results, reports, comparisons."""
