"""What every device promises, checked on any driver: of palp or another lab, simulated, emulated or real."""
