"""What stops the rig, whichever part fails."""
