"""The types of `custom` checks, one module each. Not checks by themselves: `phm_checks.custom` builds them."""
