"""What real phantoms and probes have on top of the paper's design: texture, wear, spread, a run-in."""
