"""The numbers that decide in `hil.signals` and `hil.identification`, each with its unit.

The comment beside a number names its source: a paper or a study in `benchmarks/`. For other numbers no source is
recorded.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

NORMAL: Final = 1.959964  # half a 95 % interval of a normal distribution, in standard deviations
UPPER: Final = 0.975  # quantile at the upper end of a 95 % interval
SIGNIFICANT: Final = 0.05  # probability by chance, below which two results differ
SPREAD: Final = 1.4826  # standard deviation of normal noise over its median absolute value (Rousseeuw and Croux 1993)
CLIPPED: Final = 2.5  # standard deviations, beyond which a residual counts no more (Huber 1964)
DEPENDENT: Final = 1e-12  # of the largest eigenvalue of a Gram matrix, below which columns are dependent: rounding
ROUNDED: Final = 1e-9  # of a quantity, below which it is zero but for the rounding of what it was computed from
ACCURATE: Final = 5e-4  # relative error of Kc, Bc, torque and rate that is not corrected: no sensor is better
GAIN_ERROR: Final = 3e-4  # relative error of rate and acceleration at the upper end of the band, and of their torque
BLOCKS: Final = 32  # parts of a recording whose scatter gives the error of a sum over it
TURN: Final = math.tau  # one turn, rad
SURE: Final = 4.0  # standard errors from which an effect is no chance, among the many that are looked for
NEARLY_ALL: Final = 0.98  # part of the samples that a rule must hold for, if single faults are expected
ENOUGH: Final = 65_536  # samples from which a property of a whole recording is estimated
ROWS_AT_ONCE: Final = 32_768  # samples that a thread, or a spectrum of residuals, processes at a time
ROUNDING: Final = 12.0**-0.5  # standard deviation of the error of rounding to counts, in counts
RELEVANT: Final = (5e-3, 0.03)  # relative changes of Kc and Bc from which a warning states them
FEWEST: Final = 16  # smallest number of samples, or of parts of a recording, from which anything is concluded
MOST: Final = 0.9  # quantile of a quantity that stands for its large values, without the few largest
MAJORITY: Final = 0.5  # of a whole, beyond which a part of it decides what the whole is
MANY: Final = 0.05  # part of the samples from which a fault is one of the whole recording, and not of single samples
NEGLIGIBLE: Final = 1e-3  # of a whole, below which a part of it is ignored
SAME: Final = 1e-3  # relative difference, below which two steps in time, or two grid values, count as one
TESTED: Final = 20_000  # samples to which the costly tests of a fit are limited
SMALL_PART: Final = 0.02  # of a power, a force or the samples, below which a part is of no size beside the whole
FALSE_ALARMS: Final = 0.002  # probability that a test finds an effect or a difference that does not exist

# Time stamps
PACE_ROWS = 20  # samples over which the usual pace is taken: more than arrive in one packet
APART = 4.0  # usual steps between two samples, above which they belong to two pieces, and nothing is interpolated
SHORTEST_PIECE = 8  # samples of a piece, below which nothing is interpolated on it
SAME_PACKET = 0.2  # of a usual step, below which two rows were stamped when one packet arrived
IN_PACKETS = 0.3  # part of such steps from which rows arrive in packets; samples at random times have 0.18
PACKET_LATE = 1.2  # times between two packets, by which the rows of a packet are stamped too late at most
ON_UNIT = 0.01  # of a unit, within which a stamp is a multiple of the unit
UNIT_RANGE = 1.05  # of a unit: the largest range of the rounding errors of stamps, with the error of a fitted pace
# s, units to which stamps are often rounded: decimals, and what numbers of single precision hold
UNITS = sorted([10.0**-k for k in range(2, 7)] + [2.0**-k for k in range(6, 20)], reverse=True)
STAMPS = 1000  # stamps at each end of a recording from which their unit is found

# Faults of an angle
FAR_ZERO = 1.5  # ranges of the motion, above which the angle's zero is far from it
BESIDE_JUMP = 0.1  # of a jump or a wrong reading, the most that other steps and its neighbours may have of it
ZERO_STEPS = 4  # changes of a zero in a recording, at most
STEP_TURNS = 4  # turns of the motion on each side of such a change, at least
LARGEST_STEP = 0.25  # of a turn, the most that a joint moves between two readings
TORQUE_STEP = 5.0  # usual steps of the torque, up to which it is continuous
FROZEN_TIME = 0.5  # s without a change, from which a reading may be frozen
FROZEN_STEPS = 10.0  # usual times between two changes, from which a reading may be frozen
FROZEN_TORQUE = 0.3  # of the torque's range, that the torque covers while a frozen angle stands still
WRONG_READING = 20.0  # usual distances from the neighbours' cubic, or counts, from which a reading may be wrong
BURST = 65  # readings around one that give the usual distance; a burst of wrong readings is shorter

# Rows that are not used
REPEATED = 3  # times that a jump of an angle, or a largest torque, occurs, from which it is no accident
CLIPPED_COUNT = 3.0  # times as many readings at the sensor's end as at any level below: a peak has fewer
CLIPPED_LEVELS = 6  # levels of the torque that are compared, the largest one included
CLIPPED_MOTION = 5.0  # levels of the torque, by which the joint moves on at the sensor's end
CLIPPED_BESIDE = 5  # rows on each side of a clipped one, which noise may keep just below the end
STEPS = (1e-9, 0.5)  # s between two samples: outside, the unit of the time is wrong, or the damping is not seen
UNCHANGED = 1e-12  # rad or N m peak to peak, below which an angle or a torque never changes

# Noise of the deflection
FEW_COUNTS = 20.0  # counts of the motion, peak to peak, below which a warning says so; Bc needs half of them
SHORTEST_SEGMENT = 32  # samples of a segment of a spectrum, at least; for the noise of two channels, twice as many
SHARED_BY_CHANCE = 1.4  # segments' worth of power that two channels share by chance
LESS_NOISE = 0.9  # of a noise, below which less of it is certain; of white noise the estimate is 0.97 to 1.03
AVERAGED_BY_SKEW = 1.5  # of the noise's power, per time between two readings, that a skew gains at most by averaging

# Plausibility
GROSS = 3.0  # times the stand's limit, above which the unit of a channel must be wrong
OVER_LIMIT = 1.1  # times the stand's limit, that a recorder reaches before it turns the torque off
PREFIX = 1000.0  # factor of a wrong prefix of a unit: readings further from what the limits allow have another fault
SIGN_SURE = 10.0  # standard errors of independent residuals, by which a stiffness must be negative

# Quality of a recording
JITTER = 0.99  # part of the intervals between samples that the reported jitter covers
POOR_SNR = 20.0  # dB, below which a warning says that the torque is hardly above its noise
LOST_ROWS = 0.01  # part of the rows, lost or saturated, from which a warning says so
SPARSE = 0.2  # periods of the motion between two readings, above which readings do not show it
PROBE = 1_000_000  # rows from which progress is shown, and from the first of which columns and windows are chosen
MARGIN = 256  # rows beyond the windows of a block, in place of rows that were lost

# Local polynomials (Savitzky and Golay 1964; benchmarks/results/rate_windows.csv has the noise by degree)
DEGREE = 7  # degree of the polynomial: a wide window, which averages noise, has a flat gain
SHARED_WINDOWS = 4  # half windows over one, the number of windows that share their sums
BLOCK_LENGTH = 1.3  # length of such a block over its shortest window, at most; beside a gap it holds fewer
SINGULAR = 1e-14  # of a diagonal element after elimination, below which the stamps determine no polynomial
RATE_NOISE = 0.01  # of the rate's r.m.s., the noise that lowers Bc by 0.01 %
RATE_ACCURACY = 2e-4  # of Bc: half of the most that GAIN_ERROR and RATE_NOISE can change it by
HIDDEN_NOISE = 0.3  # of the torque's own noise, that noise of the rate may add to it through Bc
FELT_INERTIA = 0.05  # of the torque's own noise, that smoothing may take off the torque of an inertia
NARROWEST = 6  # neighbours a side of the narrowest window
WIDEST = 250  # neighbours a side of the widest window
WINDOWS = 20  # windows side by side for which a recording must have room: few rows lie near its ends
NARROWER = 0.8  # width of a window over that of the next wider one that is tried
OTHER_WINDOWS = (9, 12)  # neighbours a side, at most, of the windows that show where the rate is wrong
OTHER_WIDER = (1, 3)  # neighbours a side by which these windows are wider than the one in use
FOLLOWED = 0.27  # periods of the motion in a sample, up to which a low-pass follows it

# Low-pass filter (Kaiser 1974; differences of Fornberg 1988)
KERNEL = 2.160515  # half the kernel, s, times the width of its transition, Hz, by Kaiser's formula for 70 dB
BETA = 6.75526  # parameter of the window, by Kaiser's formula for 70 dB; the gain is right to 0.03 % where it passes
FLAT = 12  # neighbours a side of the differences: right to 0.06 % up to 0.28 periods in a sample
PASSED = 1.1  # times the highest frequency of the motion, the end of the pass band
STOPPED = 1.6  # times the highest frequency of the motion, the beginning of the stop band
NYQUIST = 0.9  # of half the sampling rate, below which the stop band must begin
LEFT_BY_FILTER = 0.8  # of the samples, that the low-pass must leave
KEPT_WEIGHTS = 100_000  # samples whose weights, 20 MB, are kept for the next columns at the same stamps

# Spectrum of the deflection
OUTSIDE_BAND = 0.01  # of the deflection's power below the band, and of the rate's above it
SMOOTHED_LINES = 5  # lines of the spectrum whose mean is one density
MEDIAN_POWER = 0.934  # median over mean of the power of so many lines of white noise together
ABOVE_FLOOR = 10.0  # times the density of the noise, above which there is motion
ABOVE_ROUNDING = 1.3  # times the power of rounding, below which no motion is left above a frequency
RIPPLE_BEGINS = 2.5  # times the highest frequency of the motion, above which there may be ripple
RIPPLE_RISES = 7.0  # times the least density between motion and ripple, that the ripple reaches
TAPER = 0.02  # of a recording, that is tapered at each end

# Sensors that are slower than the rows
FEWEST_READINGS = 30  # readings from which a sensor's pace is estimated
COUNTS_A_TICK = 2.0  # counts in a tick, from which a fast sensor does not repeat a count
HELD = 0.2  # part of the moving samples that repeat, from which readings are held
UNEVEN_PACE = 0.35  # of a pace, by which it varies at most
CHANCE_PACE = 0.1  # ticks squared, the variance of a pace by chance
OFF_PACE = 0.6  # of the time between two ticks, by which a reading at an even pace may be off
MISSING = 1.75  # usual steps, from which a reading, or the tick in which one was converted, is missing
PACE_READINGS = 2000  # readings that a pace must fit
BENDS = 49  # deflections, at most, at which a torque of any shape may bend
READINGS_A_BEND = 20  # readings for each of these deflections
BRANCHES = 5  # relaxing branches of a torque of any shape, the fastest as fast as the readings
SLOWEST_BRANCH = 0.05  # of the recording's length, the relaxation time of the slowest branch
ROUNDED_MS = 1e-6  # ms, the rounding of a bound
STRAIGHT = 2.1  # counts, up to which three samples are on a line
SMALL_COUNT = 0.05  # of the usual bend or step, above which a count hides the corners between lines, or set-points
SHARP = 5.0  # times the tolerance of a line, from which a bend is a corner and no smooth motion
ON_LINES = 0.1  # part of the samples on lines, from which readings may be joined by lines
ROUGH = 2e-4  # of a sharp bend, up to which rounding to some digits bends a line
SMALL_BENDS = 1.31  # part of normal bends below a small part of their 90 % quantile, over that part
BEYOND_CHANCE = 2.0  # times the part of random bends on lines, from which lines are no chance
CORNER = 5  # samples around a corner, within which a line begins or ends
SHORT_LINES = 10  # successive lines of two samples, at most
CLEAR_CORNER = 10.0  # counts in a tick, by which two lines must differ to place their corner

# A torque that is too late
LATEST = 0.2  # s, the longest delay of a torque that is tried

# Confidence intervals
LEAST_ROUNDING = 1e-150  # N m, the least rounding of a residual: sums are divided by it
TAKES_PART = 1e-5  # of a dependent combination of columns, below which a parameter takes no part in it
FEWEST_LINES = 8  # spectral lines of a band, at least
BAND_WIDTH = 0.25  # of a band's lower end, its width: the noise of a drive changes by octaves
NEWTON_LIMIT = 200  # steps of a Newton iteration that converges in far fewer, unless it has no solution
FAR_TAIL = -20.0  # standard deviations, below which a normal distribution's positive part is its tail alone

# Errors of the deflection
NO_ERROR = 2e-5  # of the power of deflection and rate, below which their errors change nothing
WEAK_COMMAND = 0.25  # of the information without instruments, below which the command is too weak
# of the filter from command to motion, in eighths of a period: two an octave
DELAYS = (-1, 0, 1, *(part * 2**octave for octave in range(4) for part in (2, 3)))
CORRECTED = 0.1  # of half an interval, from which a parameter is corrected
STILL = 0.1  # of a count, by which low-passed readings differ at most while the joint rests
WITHIN = 0.25  # of a count, by which the model's torque differs at most while the joint rests
RESTS = 10  # such readings in a row, from which the joint rests
PAIRS = 4  # pairs of simulated errors, of either sign
ERROR_LEVEL = 0.3  # of a simulated change, its half interval: the size of the errors is not known better
IN_STEP = 2.5  # times the scatter of shuffled rounding errors, from which rounding follows the motion

# Dynamic stiffness (Pintelon and Schoukens 2012, section 2.7)
BANDS = 12  # bands, at most
CYCLES = 3.0  # periods of the lowest frequency in a segment
SEGMENTS = 8  # segments in all, at least
MAIN_LOBE = 4  # spectral lines of a band, at least: the main lobe of Hann's window
ALIKE = 2.05  # neighbouring lines and overlapping segments that count as one
ALIGNED = 1e-6  # sine of the angle between deflection and rate in a band, below which K' and B' cannot be separated
FOLLOWS = 0.4  # of the deflection's power, that follows the command; by chance a fifth does

# Tests for lack of fit
SMALL_TORQUE = 0.05  # part of the samples, those with the smallest torque
SHORT_LAG = 1e-3  # s: a shorter lag or delay has the same signature
TIMES = tuple(np.geomspace(0.002, 0.2, 6).tolist())  # s, at which an effect of the earlier motion is looked for
LENGTHS = tuple(np.geomspace(0.01, 0.8, 9).tolist())  # of the largest deflection: gaps and presliding friction
DIFFERENCE = 6  # order of the differences of the deflection in which there is noise only
EXPONENTS = np.linspace(0.0, 2.0, 41)  # of noise power over frequency, from white noise to a random walk
WAVES = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)  # waves of the torque over half the range of the angle
CELLS_A_SIDE = 7  # cells a side of the plane of deflection and rate
LAGS = np.linspace(-0.1, 0.3, 41)  # s, at which the correlation of residuals and motion is shown
UNCORRELATED = 0.05  # correlation of residuals below which they count as independent
NEAR_READINGS = 5  # readings before and after, of which a delay in the model may take one
SHORTEST_BLOCK = 25  # samples of a block, at least
MOST_BLOCKS = 64  # blocks, at most
BLOCK_LENGTHS = 8.0  # correlation times of the residuals in a block
GROSS_OUTLIER = 10.0  # standard deviations beyond which a residual is clipped where an effect's size is estimated
FLIPS = 16383  # draws of random signs of the blocks
RIDGES = (1e-4, 1e-2, 1.0)  # penalties of ridge regression, of the features' mean power
FOLDS = 10  # parts of a recording, of which each is predicted from the others
NEW_COLUMN = 1e-6  # of a column's power, that must be orthogonal to the other columns
AS_GOOD = 0.85  # of what the best effect explains, from which another effect is a suspect too
EXPLAINS = 0.4  # of the predicted part, that an effect must explain to be a suspect
GAP_FACTOR = (0.7, 1.5)  # times -Kc: the factor of the column of a gap, whose width lies between those of the columns
NARROW_GAP = 0.03  # of the largest deflection: half the width below which a gap may be narrower than its column
BY_CHANCE = 0.01  # probability that an effect explains as much, or one more measurement is as far off, by chance
MOST_NOISE = 4.0  # times the power that noise of the deflection adds to the residuals, the most that it explains
SMALL_MISFIT = (1e-3, 5e-3)  # relative changes of Kc and Bc, up to which a misfit widens intervals without a warning
PLAIN_MISFIT = 0.1  # of the residuals' power: so much is a misfit even if it changes neither Kc nor Bc
DOUBLED_ERRORS = 1.5  # times its own power, that doubled errors of the motion add to the prediction
NOT_OF_NOISE = 0.05  # of what is predicted, up to which errors of the motion explain almost nothing
REPEATED_ROUNDING = 0.25  # of the power that errors add, above which its scatter is that of rounding that repeats
OTHER_JOINT = 0.15  # of the torque's deviation: a model that leaves so much is that of another joint

# Choice of the model
BAND_NEIGHBOURS = 5  # neighbours a side of the polynomial that moves unevenly stamped readings to an even grid
CERTAIN_RATES = 0.2  # samples with a certain rate over all, from which (up to NEARLY_ALL) only these are used
ABOVE_ERRORS = 100.0  # times the power of its errors, which that of the deflection has in the band
SMOOTHED_SPECTRUM = 0.5  # Hz, over which the spectra that give the band are smoothed
NOISE_WEIGHTS = 12  # weights of the autoregression of the noise, at most
ROWS_A_WEIGHT = 60  # rows needed for each of these weights
COMMON = 0.5  # probability of a term that model selection considers from the start
RARE = 0.1  # the same of a rare one: of what one bench or joint in ten has
SELDOM = 0.02  # the same of a term with a break, which fits much by chance, and of one that is rarer than its class
EXPANDED = 24  # candidates that are expanded, at most
GRID_POINTS = 3  # best grid values of the same terms that are added to a candidate
CONVERGED = 1e-4  # of the sum of squares, by which a step lowers it less when the fit has converged
ROUNDS = 4  # rounds of search and fit, at most
FITTED = 2  # candidates of different terms that a round fits
STOP = 30.0  # times the stiffness in one direction, from which a spring is a stop in the other
GAP_OF_NOISE = 6.0  # standard deviations from the outermost reading, within which a gap fits errors of a joint at rest
SEARCH_BLOCKS = 20  # blocks in time, which give the number of independent samples of a search
STRONG = 6.0  # twice the log odds from which evidence is strong (Kass and Raftery 1995): a grid value costs less
OCCAM = 2.0 * STRONG  # of the best score, below which a candidate is not expanded (Madigan and Raftery 1994)
VERY_STRONG = 10.0  # the same that a rare term, one with a break and one that the search did not propose must exceed
CLEARLY = 2.0  # standard errors over blocks, or deviations of simulations, by which one value clearly exceeds another
BETTER = 1.0  # the same, from which it is better
CONFUSED = 1000.0  # variance inflation from which model selection includes no term with such a parameter
RIVAL = 1.1  # factor by which a term may worsen the fitness and still be a rival
EXCHANGES = 6  # terms that the exact fit removes or adds, at most
SELECTED_FROM = 40_000  # samples from which a model is selected
STRETCHES = 8  # stretches of a long recording that these samples make up
STICKING = 1.25  # ratio of the error of slow samples to that of the others, from which the two differ
KNOWN_MEAN = 100  # samples that determine a mean error

# Held set-points and steps
USUAL_DRIVE = 32.0  # Hz, natural frequency of a drive that holds its set-points
DRIVE_DAMPING = 0.75  # damping ratio of a drive
TAKEN_OFF = 0.1  # of the rate, that a drive which the readings still follow takes off, at most
DENSE_READINGS = 20.0  # readings in a period, which follow a drive between set-points; what is faster is their noise

# Fit
IN_MEMORY = 4_000_000  # rows, all recordings together, up to which the signals are held in memory
TABLE_ROWS = 1 << 18  # rows of a table that are read or computed at a time
LONG_SEARCH = 5_000_000  # generations from which a search says how long it will take
TRIALS = 30  # the paper's trials of a search
NONLINEAR_TRIALS = 5  # trials of a search for nonlinear parameters, half a second each
CURVE_ROWS = 6000  # samples that give the static torque over the deflection, or the band without a low-pass
CURVE_DEGREES = tuple(range(1, 10, 2))  # of that curve: the first is used beyond which nothing is evident
LEAST_SIDE = 0.125  # of the motion, over which the two sides of a deflection are compared at least
CURVE_POINTS = 200  # points at which a curve over a range is computed
SAME_PLACE = 1.0 / 40.0  # of the motion: two places anywhere in it are nearer by chance in one case of twenty
RESOLVED = 1e-4  # of a range, within which two values in it are the same
JACOBIAN_STEP = 1e-6  # of the bounds' width, for a user's Jacobian

# Verdict
HELD_JUMPS = 1.5  # times its computed size, below which the torque of held set-points is one
ENOUGH_PAIRS = 2  # pairs of simulated errors, which show that errors are far too small
SURE_BAND = 2.0  # half widths of an interval, beyond which none of a dozen bands is by chance
LACKING = 0.03  # of the dynamic stiffness, a change over the band that is said, and a lack that refuses a model
OFF_COUNTS = 0.2  # counts, by which a reading in counts is off their grid at most
RESPECTS = 3  # respects that a message names
TESTED_MOTION = 0.1  # of the motion, below which what is tested looks too much like friction or inertia
OUTERMOST = 0.002  # of the samples at either end of a range, which may be outliers
LITTLE_EARLY = 0.5  # times what recorders are early by, from which an early reading is doubted beside an inertia
FIRST_ORDER = 0.15  # relative simulated change, from which the simulation is too rough

# When a result is trusted, planned and identified
COUPLING: Final = ("Kc", "Bc")  # names of the parameters that a usable result must contain
INFLATION = 300.0  # variance inflation, at which 6 % (300**-0.5) of error in the columns make a value wrong by itself
INTERVAL = 0.35  # half the interval of Kc or Bc over its value: two recordings of one joint may then differ by a half
UNCERTAIN = 0.1  # the same, from which a warning says why the interval is so wide
LIKE_FRICTION = 0.95  # `friction_likeness` from which Bc cannot be distinguished from a friction that the model lacks
ONE_SPEED = 0.79  # the same, from which most of such a friction is in Bc: a triangle has 1, a sine 0.81, a chirp 0.72
OPTIMISER_GAP = 1e-3  # optimiser gap from which a search has not converged: a tenth of the usual interval of Kc
UNEXPLAINED = 0.9  # of the torque's spread, that a model which explains nothing leaves in held-out blocks
TICK_SHARE = 0.1  # ticks, standard deviation of the difference in age of one recorder's torque and angle
LONGEST_SKEW = 1.5  # ticks, above which one recorder is unlikely to be the cause of a skew
BETWEEN = 3.0  # standard deviation between recordings over that within, from which they really differ
DIFFERENT = 3.0  # ratio of two values of Kc in one model that no single Kc describes
LITTLE_FRICTION = 0.2  # friction over torque, up to which Kc repeats: in real ramps with 0.2 to 0.3 within 4 % (median)
PLAY = 0.75  # play over the range of the deflection, from which too little of the motion loads the spring
LATE_READING = 4e-3  # s, age of a torque that is late: r.m.s. of the lags of cells of 15 to 480 Hz, by octaves
ONE_IN_TEN = -2.0 * math.log(RARE)  # twice the log odds against what one bench or joint in ten has
RELAXING = 33.0**-0.5  # of the apparent delay, that a branch causes in one joint of ten: any part, r.m.s.
FURTHER = 3.0**-0.5  # the same where two branches were found: what relaxes does so at more speeds
PLACES = 2**44  # steps of a range, to one of which a quantile is found
FALLS_OVER = np.geomspace(0.25, 1.0, 5)  # of the rate of which damping is felt: friction that falls over less is none
RISE = 0.5  # of friction at speed, by which it is higher at rest: a standard deviation
GROWTH = 1.0  # of Bc, by which damping is higher at the rate of which it is felt: a standard deviation
STIFFEST = 2.0  # times Kc, what relaxes faster than the joint moves: a standard deviation
UNEVEN = 0.03  # of the spring's torque, that a curve, a gap or friction makes unseen: a standard deviation
BUILDS_UP = 0.05  # of the stroke, over which such friction builds up
RELAXES = 12  # relaxation times of such a branch, half an octave apart
