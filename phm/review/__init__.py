"""After the flight: records of agents and of the ground become one report. Nothing here runs on board.

Records (`sources`) -> events -> parts (`part`, one for each segment of a file, in several processes) -> one record (`record_reader`), with
one time axis (`clocks`) -> the document (`document`), a JSON object that the terminal, the page and all files are made of.
"""
