"""Records with a hidden effect, made by a generator that shares no numerical code with the solver under test.

From ``solver`` it takes the dataclasses of a network and their numbers, and nothing that computes. Time is a Fourier
series of one beat (harmonic balance), space is Chebyshev-Lobatto points with equations collocated at Gauss points; the
inflow shapes, the noise and the separations d' are its own, too.

    anatomy.py  what flows and what the walls are: a network's numbers, and every hidden effect as a change of them
    animal.py   what an animal has of its own: scales common to its walls, and each wall by itself
    beat.py     one period as a Fourier series, and its samples
    wall.py     the wall's pressure of an area and its rate
    hide.py     hidden effects by name and size, and their parameters
    pieces.py   points on the vessels
    network.py  the periodic flow in a network, by harmonic balance
    bench.py    the periodic radius of one piece of artery under a given pressure
    shapes.py   ejection and pressure waveforms
    sensors.py  what sensors make of the truth: lag, gain, offset, resonance, noise, drift, steps, jitter
    varying.py  records whose beats differ in interval and stroke
    records.py  cases and their records
    detect.py   d' and separation of a hidden effect; refit.py its least squares, rivals.py what looks alike
    plan.py     the lists of cases of the bank
"""
