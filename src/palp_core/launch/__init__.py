"""palp_core.launch"""
