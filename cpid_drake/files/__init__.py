"""Files: checked YAML, outputs that are written whole, figures, shipped files, `InputError`."""
