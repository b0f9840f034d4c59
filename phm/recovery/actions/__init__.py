"""The actions that come with PHM, one module each, loaded through the entry points of the group `phm.actions`."""
