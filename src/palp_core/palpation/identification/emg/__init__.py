"""Co-contraction and strategies, from recorded EMG."""
