"""Files of laboratories as tables of named columns; a further kind of file is a line of ``kinds.py``."""
