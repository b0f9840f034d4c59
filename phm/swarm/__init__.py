"""What agents know of each other, and what they agree on. Pure: frames and time are brought by the caller."""
