"""Messages of the pendulum."""
