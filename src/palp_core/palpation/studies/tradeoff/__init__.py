"""Error against time, method by method, on the scene and the machine of whoever asks."""
