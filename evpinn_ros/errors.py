"""The one error a person can mend: wrong input, said in one line."""


class InputError(Exception):
    """A file, message or setting given by a person is wrong.

    The text names the file (and line, where there is one) and the reason in one line; commands
    print it as it is and exit with code 1.
    """
