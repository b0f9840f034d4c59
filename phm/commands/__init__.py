"""What comes in from the ground: commands, judged, carried out and acknowledged."""
