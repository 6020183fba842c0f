"""Co-contraction from EMG."""
