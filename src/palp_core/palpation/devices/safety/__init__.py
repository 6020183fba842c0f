"""What stops the rig, whoever fails."""
