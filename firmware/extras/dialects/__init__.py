"""What other controllers say and understand."""
