"""Messages of the palpation rig, by subject; every quantity names its unit."""
