"""The program as a user at the terminal sees it.

Every verb once, and every wrong input that a user is likely to give. A wrong input ends with one line that
says what is wrong and what to do, and with a non-zero exit code. The motors are off, and everything logged
so far is kept. Only the ports of the machine are faked.
"""
