"""What `phm logs` does: read and follow logs, explain their lines, and bundle them for a report of a problem."""
