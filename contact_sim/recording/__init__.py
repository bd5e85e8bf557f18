"""What remains of a simulated flight: how it truly was, and the film of it.

::

    truth.py     while it is flown: truth.jsonl in the run's folder
    reel.py      what was there to see at each moment: picture, answer, control tick, truth
    chase.py     where the camera flies that follows the drone
    stage.py     the world once more, drawn from there
    panels.py    the drone's own picture with what was found in it; the words
    curves.py    h, d1 + d2 and the force over time
    encoder.py   pictures -> video file
    film.py      all of it
    world.py     which world it was, from the run's files
    command.py   python -m contact_sim film
"""
