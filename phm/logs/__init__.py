"""What `phm logs` does: read and follow logs, explain their lines, fetch them, and bundle them for a report of a problem."""
