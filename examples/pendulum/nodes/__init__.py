"""A pendulum that is held upright: who asks, who controls, what swings, who draws."""
