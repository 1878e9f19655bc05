"""Claims about fits.

Numbers found again on rigs whose numbers only the test knows (`made.py` flies them on the simulated board,
link and all), simulated flights explained down to the quantisation, and measured pairs two seconds ahead
where those data lie beside the project.
"""
