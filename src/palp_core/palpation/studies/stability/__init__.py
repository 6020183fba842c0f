"""Where methods fail: contact, joint, belief, signals."""
