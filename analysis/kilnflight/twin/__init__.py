"""The twin: a kiln whose truth is known.

    fractions -> flight (gas, forces, burning) -> what the camera sees -> recording, truth

It never sees a method, and no method sees it. Every coefficient is a field with unit and
source; nothing is tuned to the outcome of a measuring method.
"""
