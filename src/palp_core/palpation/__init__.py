"""The rig: mechanics, perception, devices, sessions and studies."""
