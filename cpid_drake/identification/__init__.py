"""From data and a spacecraft model to a result."""

import lazy_loader

# The names are those of __init__.pyi; each is imported when it is first used.
__getattr__, _, _ = lazy_loader.attach_stub(__name__, __file__)
