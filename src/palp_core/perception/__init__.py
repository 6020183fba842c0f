"""palp_core.perception"""
