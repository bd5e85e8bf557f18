"""The paper's figures, and some beyond it, drawn from flights of the real client.

``catalogue.py`` lists them, ``command.py`` is the command line (``scripts/figures``), ``bench.py``
flies what they need, once. Every figure carries its own caption, with the numbers that it shows.
"""
