"""palp_core.cli"""
