"""`phm init`: looks at this machine, takes the answers of the operator, and creates a folder with everything needed to start PHM.

`machine` is what was found, `discovery` finds it, `answers` and `questions` are what the operator decides, `render` makes the
files and `folder` writes them.
"""
