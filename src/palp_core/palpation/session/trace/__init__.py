"""The whole torque of a sweep as the reading of a session: what a node and a re-analysis share."""
