"""A whole sweep as one reading: torque by position, and a belief that follows it bin by bin."""
