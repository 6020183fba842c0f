"""palp_core.mechanics"""
