"""What real phantoms and probes have beside the paper's design: texture, wear, spread, a run-in."""
