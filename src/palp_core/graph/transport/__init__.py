"""Messages over ZeroMQ, each of them accounted for."""
