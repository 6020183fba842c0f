"""What was decided about a session: whose trials count, and what nobody is told yet."""
