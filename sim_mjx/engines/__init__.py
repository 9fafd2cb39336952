"""Physics engines behind one function; none of them knows the task."""
