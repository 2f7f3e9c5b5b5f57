"""A film of one's own: settings, motion, noise, doubts, the run of all steps, report,
pictures.

recording + `settings.Options` -> `preparation` -> `kilnflight.chain` -> tables,
summary, pictures

`kilnflight.open`, `detect`, `track` and `plot_tracks` are the same steps in Python, and
``kilnflight.run(film, "results")`` is all of them.
"""
