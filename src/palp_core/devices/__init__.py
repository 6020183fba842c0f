"""palp_core.devices"""
