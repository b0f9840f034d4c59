"""Codecs that the reporter, the peers and the ground share. Pure: no input, no output, no clock."""
