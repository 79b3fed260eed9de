"""Optional parts. A board loads only those that its board file asks for."""
