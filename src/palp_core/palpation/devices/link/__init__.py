"""What drivers share: lines, clocks, reconnection."""
