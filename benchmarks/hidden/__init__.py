"""The bank of hidden effects: the modules of ``benchmarks/hidden_effects.py``.

row.py      one record, judged: truth, verdict and numbers as one line of JSON
bank.py     a file of such lines, resumable
words.py    named right, single, wrong, in class: what the bank counts, of one line
counts.py   proportions with bounds, and the tables of counts
targets.py  a table of targets: met, open or missed; animals.py those of the groups
tables.py   the tables behind them; calibration.py what a confidence is worth, with its diagram
report.py   the report in Markdown
"""
