"""What an operator asks recovery for, and what recovery reports to the operator."""
