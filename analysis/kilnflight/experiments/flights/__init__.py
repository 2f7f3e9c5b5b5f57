"""The protocols of chapters 5.2 and 5.3: tracked windows, campaigns whose flights
count.
"""
