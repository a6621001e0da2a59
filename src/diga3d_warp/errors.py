"""The one exception that means: the input is wrong, and here is what would mend it."""


class InputError(ValueError):
    """Bad input from the user: one line that names the file, what is wrong, and what would mend it.

    The command line prints the line and exits with code 2, without a traceback.
    """
