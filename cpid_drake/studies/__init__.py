"""Studies: whole experiments that answer one question each, without drawing or printing."""
