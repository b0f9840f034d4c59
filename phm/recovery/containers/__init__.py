"""What recovery knows about containers: generations, dependents, external changes, lowered CPU weights."""
