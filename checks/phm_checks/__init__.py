"""The checks that come with PHM: one check, one file, found through the entry-point group `phm.checks`."""
