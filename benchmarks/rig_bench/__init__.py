"""A rig under test: launch/rig.yaml on emulated devices of this process, which sees all that they receive."""
