"""palp_core.studies"""
