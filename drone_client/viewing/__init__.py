"""Looking at a flight with the viewers that people know: MCAP and Foxglove, Rerun.

::

    recorder.py     during the flight: poses, pictures, and what must be known of the drone
    run_folder.py   a run's files as moments in the order of time; grown ones as they come
    foxglove.py     moments -> MCAP, or live to whoever connects
    rerun_file.py   moments -> .rrd
    whole_file.py   a file has its name only when it is whole

A run folder is all that it takes: of a flight today, last year's, or one that is under way.
"""
