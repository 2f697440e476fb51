"""Studies: complete experiments that answer one question each; they neither draw nor print."""
