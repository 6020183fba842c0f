"""palp_core.runtime"""
