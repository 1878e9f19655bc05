"""What a person at the terminal sees.

Every verb once, and every wrong input that a person is likely to give: one line that says what and what to
do, an exit code that is not zero, motors off, nothing lost that was already logged. Nothing is faked but
the ports of the machine.
"""
