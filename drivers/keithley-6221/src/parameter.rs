//! Settings that are one number, one switch or one word each. One table holds their notation, limits and reset values;
//! grammar, read-back, MIN, MAX, DEF, `*RST` and `*SAV` use it.
//!
//! Source: fact sheet, section 4. Where the fact sheet has no reset value, the value here is assumed.

use scpi::Unit;

use crate::Kind;

/// The group of a parameter; a parameter of a running sweep or wave cannot be changed.
#[cfg(feature = "simulator")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Subject {
    Sweep,
    /// Wave settings that are fixed while the wave runs.
    Wave,
    /// Wave settings that take effect at once while the wave runs.
    LiveWave,
    /// Survives `*RST`.
    Communication,
    Other,
}

macro_rules! parameters {
    ($($(#[$doc:meta])* $name:ident: $subject:ident, $notation:literal, $kind:expr;)*) => {
        /// A setting that is one value.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Parameter { $($(#[$doc])* $name,)* }

        impl Parameter {
            /// Every parameter, in the order of the manual's chapters.
            pub const ALL: &'static [Parameter] = &[$(Parameter::$name,)*];

            /// The header in the manual's notation.
            pub fn notation(self) -> &'static str {
                match self { $(Parameter::$name => $notation,)* }
            }

            /// The values that the parameter takes.
            pub fn kind(self) -> Kind {
                match self { $(Parameter::$name => $kind,)* }
            }

            #[cfg(feature = "simulator")]
            pub(crate) fn subject(self) -> Subject {
                match self { $(Parameter::$name => Subject::$subject,)* }
            }
        }
    };
}

const MOST: f64 = 0.105;
const LONGEST: f64 = 999_999.999;

const fn real(unit: Unit, min: f64, max: f64, def: f64) -> Kind {
    Kind::Real {
        unit,
        limits: [min, max, def],
        endless: false,
    }
}

const fn real_or_inf(unit: Unit, min: f64, max: f64, def: f64) -> Kind {
    Kind::Real {
        unit,
        limits: [min, max, def],
        endless: true,
    }
}

const fn amps(min: f64, max: f64, def: f64) -> Kind {
    real(Unit::Ampere, min, max, def)
}

const fn seconds(min: f64, max: f64, def: f64) -> Kind {
    real(Unit::Second, min, max, def)
}

const fn plain(min: f64, max: f64, def: f64) -> Kind {
    real(Unit::None, min, max, def)
}

const fn whole(min: f64, max: f64, def: f64) -> Kind {
    Kind::Whole {
        limits: [min, max, def],
        endless: false,
    }
}

const fn whole_or_inf(min: f64, max: f64, def: f64) -> Kind {
    Kind::Whole {
        limits: [min, max, def],
        endless: true,
    }
}

parameters! {
    /// Duration of each point of a linear or logarithmic sweep, s.
    Delay: Sweep, "[SOURce][:CURRent]:DELay", seconds(1e-3, LONGEST, 1.0);
    /// First level of a sweep.
    Start: Sweep, "[SOURce]:CURRent:STARt", amps(-MOST, MOST, 0.0);
    /// Last level of a sweep.
    Stop: Sweep, "[SOURce]:CURRent:STOP", amps(-MOST, MOST, 0.1);
    /// Step of a linear sweep.
    Step: Sweep, "[SOURce]:CURRent:STEP", amps(1e-13, MOST, 0.01);
    /// Mean of first and last level.
    Center: Sweep, "[SOURce]:CURRent:CENTer", amps(-MOST, MOST, 0.05);
    /// Difference of last and first level.
    Span: Sweep, "[SOURce]:CURRent:SPAN", amps(0.0, 2.0 * MOST, 0.1);
    /// Spacing of the points of a sweep.
    Spacing: Sweep, "[SOURce][:CURRent]:SWEep:SPACing", Kind::Choice(&["LINear", "LOGarithmic", "LIST"]);
    /// Points of a sweep.
    Points: Sweep, "[SOURce][:CURRent]:SWEep:POINts", whole(1.0, 65_535.0, 11.0);
    /// Number of runs of a sweep.
    Count: Sweep, "[SOURce][:CURRent]:SWEep:COUNt", whole_or_inf(1.0, 9_999.0, 1.0);
    /// Range of a sweep: the smallest that holds all points, the smallest that holds each point, or the present range.
    Ranging: Sweep, "[SOURce][:CURRent]:SWEep:RANGing", Kind::Choice(&["BEST", "AUTO", "FIXed"]);
    /// Whether compliance ends a sweep.
    AbortOnCompliance: Sweep, "[SOURce][:CURRent]:SWEep:CABort", Kind::Switch(false);

    /// Shape of the wave.
    Function: Wave, "[SOURce]:WAVE:FUNCtion", Kind::Choice(&[
        "SINusoid", "SQUare", "RAMP", "ARBitrary0", "ARBitrary1", "ARBitrary2", "ARBitrary3", "ARBitrary4",
    ]);
    /// Frequency of the wave.
    Frequency: LiveWave, "[SOURce]:WAVE:FREQuency", real(Unit::Hertz, 1e-3, 1e5, 1e3);
    /// Peak amplitude of the wave.
    Amplitude: LiveWave, "[SOURce]:WAVE:AMPLitude", amps(2e-12, MOST, 1e-3);
    /// Offset of the wave.
    Offset: LiveWave, "[SOURce]:WAVE:OFFSet", amps(-MOST, MOST, 0.0);
    /// Per cent of a period that a square is high, or a ramp rises.
    DutyCycle: Wave, "[SOURce]:WAVE:DCYCle", plain(0.0, 100.0, 50.0);
    /// Duration of the wave, s.
    WaveTime: Wave, "[SOURce]:WAVE:DURation:TIME", real_or_inf(Unit::Second, 100e-9, LONGEST, f64::INFINITY);
    /// Duration of the wave in periods.
    WaveCycles: Wave, "[SOURce]:WAVE:DURation:CYCLes", real_or_inf(Unit::None, 1e-3, 99_999_999_900.0, f64::INFINITY);
    /// Range of the wave.
    WaveRanging: Wave, "[SOURce]:WAVE:RANGing", Kind::Choice(&["BEST", "FIXed"]);
    /// Whether the wave marks a phase on a trigger line.
    PhaseMarker: Other, "[SOURce]:WAVE:PMARk:STATe", Kind::Switch(false);
    /// The marked phase, degrees; the manual's scale is 0 to 360, common clients use -180 to 180.
    MarkedPhase: Other, "[SOURce]:WAVE:PMARk[:LEVel]", plain(-180.0, 360.0, 180.0);
    /// Whether a trigger starts the wave (public drivers send `SOUR:WAVE:EXTR`, `:ILIN`, `:IGN`, `:IVAL`, with these
    /// limits). The simulator has no such trigger, and does not arm such a wave.
    ExternalTrigger: Wave, "[SOURce]:WAVE:EXTRig[:ENABle]", Kind::Switch(false);
    /// The trigger line that starts the wave; 0 for none.
    ExternalLine: Wave, "[SOURce]:WAVE:EXTRig:ILINe", whole(0.0, 6.0, 1.0);
    /// Whether triggers are ignored while the wave is running.
    IgnoreTriggers: Wave, "[SOURce]:WAVE:EXTRig:IGNore", Kind::Switch(false);
    /// Output before and after a triggered wave, as a fraction of its amplitude.
    InactiveValue: Wave, "[SOURce]:WAVE:EXTRig:IVALue", plain(-1.0, 1.0, 0.0);
    /// The trigger line of the phase marker.
    MarkerLine: Other, "[SOURce]:WAVE:PMARk:OLINe", whole(1.0, 6.0, 3.0);

    /// High level of delta mode; setting it also sets the low level to its negative.
    DeltaHigh: Other, "[SOURce]:DELTa:HIGH", amps(0.0, MOST, 1e-3);
    /// Low level of delta mode.
    DeltaLow: Other, "[SOURce]:DELTa:LOW", amps(-MOST, 0.0, -1e-3);
    /// Delay of delta mode, s.
    DeltaDelay: Other, "[SOURce]:DELTa:DELay", real_or_inf(Unit::Second, 0.0, 9_999.999, 2e-3);
    /// Cycles of delta mode.
    DeltaCount: Other, "[SOURce]:DELTa:COUNt", whole_or_inf(1.0, 65_536.0, f64::INFINITY);
    /// Whether compliance ends delta mode.
    DeltaAbort: Other, "[SOURce]:DELTa:CABort", Kind::Switch(false);
    /// Whether delta mode uses cold switching.
    DeltaColdSwitch: Other, "[SOURce]:DELTa:CSWitch", Kind::Switch(false);

    /// First level of differential conductance.
    ConductanceStart: Other, "[SOURce]:DCONductance:STARt", amps(-MOST, MOST, -10e-6);
    /// Step of differential conductance.
    ConductanceStep: Other, "[SOURce]:DCONductance:STEP", amps(0.0, MOST, 1e-6);
    /// Last level of differential conductance.
    ConductanceStop: Other, "[SOURce]:DCONductance:STOP", amps(-MOST, MOST, 10e-6);
    /// Alternating level of differential conductance.
    ConductanceDelta: Other, "[SOURce]:DCONductance:DELTa", amps(0.0, MOST, 1e-6);
    /// Delay of differential conductance, s.
    ConductanceDelay: Other, "[SOURce]:DCONductance:DELay", seconds(1e-3, 9_999.999, 2e-3);
    /// Whether compliance ends differential conductance.
    ConductanceAbort: Other, "[SOURce]:DCONductance:CABort", Kind::Switch(false);

    /// High level of pulse delta.
    PulseHigh: Other, "[SOURce]:PDELta:HIGH", amps(-MOST, MOST, 1e-3);
    /// Low level of pulse delta.
    PulseLow: Other, "[SOURce]:PDELta:LOW", amps(-MOST, MOST, 0.0);
    /// Width of a pulse, s.
    PulseWidth: Other, "[SOURce]:PDELta:WIDTh", seconds(50e-6, 12e-3, 110e-6);
    /// Delay within a pulse, s.
    PulseDelay: Other, "[SOURce]:PDELta:SDELay", seconds(16e-6, 11.966e-3, 16e-6);
    /// Number of pulses.
    PulseCount: Other, "[SOURce]:PDELta:COUNt", whole_or_inf(1.0, 65_636.0, f64::INFINITY);
    /// Range of the pulses.
    PulseRanging: Other, "[SOURce]:PDELta:RANGing", Kind::Choice(&["BEST", "FIXed"]);
    /// Power-line cycles between pulses.
    PulseInterval: Other, "[SOURce]:PDELta:INTerval", whole(1.0, 999_999.0, 5.0);
    /// Whether pulses are swept.
    PulseSweep: Other, "[SOURce]:PDELta:SWEep[:STATe]", Kind::Switch(false);
    /// Low measurements for each pulse.
    PulseLowMeasurements: Other, "[SOURce]:PDELta:LMEasure", whole(1.0, 2.0, 2.0);

    /// The event that the arm layer waits for.
    ArmSource: Sweep, "ARM[:SEQuence][:LAYer]:SOURce", Kind::Choice(&[
        "IMMediate", "TIMer", "BUS", "TLINk", "BSTest", "PSTest", "NSTest", "MANual",
    ]);
    /// Time from one pass of the arm layer to the next, s.
    ArmTimer: Sweep, "ARM[:SEQuence][:LAYer]:TIMer", seconds(0.0, 99_999.99, 0.1);
    /// Input trigger line of the arm layer.
    ArmInput: Sweep, "ARM[:SEQuence][:LAYer][:TCONfigure]:ILINe", whole(1.0, 6.0, 1.0);
    /// Output trigger line of the arm layer.
    ArmOutputLine: Sweep, "ARM[:SEQuence][:LAYer][:TCONfigure]:OLINe", whole(1.0, 6.0, 2.0);
    /// When the arm layer sends an output trigger.
    ArmOutput: Sweep, "ARM[:SEQuence][:LAYer][:TCONfigure]:OUTPut", Kind::Choice(&["NONE", "TENTer", "TEXit"]);
    /// Whether the event of the arm layer is bypassed once.
    ArmDirection: Sweep, "ARM[:SEQuence][:LAYer][:TCONfigure]:DIRection", Kind::Choice(&["ACCeptor", "SOURce"]);
    /// The event that the trigger layer waits for.
    TriggerSource: Sweep, "TRIGger[:SEQuence][:LAYer]:SOURce", Kind::Choice(&["IMMediate", "TLINk"]);
    /// Input trigger line of the trigger layer.
    TriggerInput: Sweep, "TRIGger[:SEQuence][:LAYer][:TCONfigure]:ILINe", whole(1.0, 6.0, 1.0);
    /// Output trigger line of the trigger layer.
    TriggerOutputLine: Sweep, "TRIGger[:SEQuence][:LAYer][:TCONfigure]:OLINe", whole(1.0, 6.0, 2.0);
    /// When the trigger layer sends an output trigger.
    TriggerOutput: Sweep, "TRIGger[:SEQuence][:LAYer][:TCONfigure]:OUTPut", Kind::Choice(&["NONE", "SOURce", "DELay"]);
    /// Whether the event of the trigger layer is bypassed once.
    TriggerDirection: Sweep, "TRIGger[:SEQuence][:LAYer][:TCONfigure]:DIRection", Kind::Choice(&["ACCeptor", "SOURce"]);

    /// Size of the buffer, readings; the limit is the one that common clients use.
    BufferPoints: Other, "TRACe:POINts", whole(1.0, 1_000_000.0, 100.0);
    /// Readings at which the buffer notifies.
    BufferNotify: Other, "TRACe:NOTify", whole(1.0, 65_536.0, 50.0);
    /// Source of the readings in the buffer.
    BufferFeed: Other, "TRACe:FEED", Kind::Choice(&["SENSe", "SENSe1", "CALCulate", "CALCulate1", "NONE"]);
    /// Whether the buffer is filled.
    BufferControl: Other, "TRACe:FEED:CONTrol", Kind::Choice(&["NEVer", "NEXT"]);
    /// Format of the buffer's time stamps.
    BufferStamp: Other, "TRACe:TSTamp:FORMat", Kind::Choice(&["ABSolute", "DELTa"]);
    /// Format of readings.
    DataFormat: Other, "FORMat[:DATA]", Kind::Choice(&["ASCii", "REAL", "SREal", "DREal"]);
    /// Format of registers: decimal, or as `#H`, `#Q`, `#B` numbers (public drivers send ASC; 622x reference manual,
    /// FORMat subsystem \[K\]).
    RegisterFormat: Other, "FORMat:SREGister", Kind::Choice(&["ASCii", "HEXadecimal", "OCTal", "BINary"]);
    /// Byte order of binary readings.
    ByteOrder: Other, "FORMat:BORDer", Kind::Choice(&["NORMal", "SWAPped"]);
    /// Unit of delta readings.
    ReadingUnit: Other, "UNIT[:VOLTage][:DC]", Kind::Choice(&["V", "OHMS", "W", "SIEMens"]);
    /// Whether the reading of a pulse is its peak or its average power.
    PowerUnit: Other, "UNIT:POWer[:TYPE]", Kind::Choice(&["PEAK", "AVERage"]);
    /// Mathematics on delta readings: none, m X + b, m / X + b (public drivers; reset value assumed).
    MathFormat: Other, "CALCulate:FORMat", Kind::Choice(&["NONE", "MXB", "RECiprocal"]);
    /// Factor m.
    MathFactor: Other, "CALCulate:KMATh:MMFactor", plain(-9.999_99e20, 9.999_99e20, 1.0);
    /// Summand b.
    MathOffset: Other, "CALCulate:KMATh:MBFactor", plain(-9.999_99e20, 9.999_99e20, 0.0);
    /// Whether mathematics is applied.
    Math: Other, "CALCulate:STATe", Kind::Switch(false);
    /// Statistic of the buffer (public drivers).
    StatisticFormat: Other, "CALCulate2:FORMat", Kind::Choice(&["MEAN", "SDEViation", "MAXimum", "MINimum", "PKPK"]);
    /// Whether the statistic is computed.
    Statistic: Other, "CALCulate2:STATe", Kind::Switch(false);
    /// Whether compliance is tested and the result shown on the output lines (public drivers; nothing is connected to
    /// these lines).
    LimitTest: Other, "CALCulate3:LIMit[:STATe]", Kind::Switch(false);
    /// The pattern of the output lines in compliance.
    LimitPattern: Other, "CALCulate3:LIMit:SOURce", whole(0.0, 15.0, 0.0);
    /// Whether the output lines show the forced pattern.
    ForcedOutput: Other, "CALCulate3:FORCe:STATe", Kind::Switch(false);
    /// The forced pattern.
    ForcedPattern: Other, "CALCulate3:FORCe:PATTern", whole(0.0, 15.0, 0.0);
    /// Whether delta readings are averaged.
    Average: Other, "SENSe:AVERage[:STATe]", Kind::Switch(false);
    /// How delta readings are averaged.
    AverageControl: Other, "SENSe:AVERage:TCONtrol", Kind::Choice(&["MOVing", "REPeat"]);
    /// Delta readings in an average.
    AverageCount: Other, "SENSe:AVERage:COUNt", whole(2.0, 300.0, 10.0);
    /// Window of the average, per cent of the range.
    AverageWindow: Other, "SENSe:AVERage:WINDow", plain(0.0, 10.0, 0.0);

    /// Whether the display is lit.
    Display: Other, "DISPlay:ENABle", Kind::Switch(true);
    /// Whether a text is shown on the upper line (public drivers send `DISP:WIND1|2:TEXT:DATA|STAT`).
    UpperText: Other, "DISPlay[:WINDow]:TEXT:STATe", Kind::Switch(false);
    /// Whether a text is shown on the lower line.
    LowerText: Other, "DISPlay:WINDow2:TEXT:STATe", Kind::Switch(false);
    /// Whether the beeper may sound.
    Beeper: Other, "SYSTem:BEEPer:STATe", Kind::Switch(true);
    /// Whether keys click.
    KeyClick: Other, "SYSTem:KCLick", Kind::Switch(true);
    /// Which setup is loaded at power on.
    PowerOn: Communication, "SYSTem:POSetup", Kind::Choice(&["RST", "PRESet", "SAV0", "SAV1", "SAV2", "SAV3", "SAV4"]);
    /// Address on the GPIB.
    GpibAddress: Communication, "SYSTem:COMMunicate:GPIB:ADDRess", whole(0.0, 30.0, 12.0);
    /// Baud rate of the serial port.
    Baud: Communication, "SYSTem:COMMunicate:SERial:BAUD", whole(300.0, 115_200.0, 9_600.0);
    /// Flow control of the serial port.
    Pace: Communication, "SYSTem:COMMunicate:SERial:PACE", Kind::Choice(&["NONE", "XON", "XOFF"]);
    /// Terminator of a line on the serial port.
    Terminator: Communication, "SYSTem:COMMunicate:SERial:TERMinator", Kind::Choice(&["LF", "CR", "CRLF", "LFCR"]);
    /// How the serial port's RTS line is used.
    Handshake: Communication, "SYSTem:COMMunicate:SERial:CONTrol:RTS", Kind::Choice(&["OFF", "IBFull", "RFR"]);
    /// Whether the keys are locked, including the LOCAL key.
    Lockout: Communication, "SYSTem:COMMunicate:RWLock", Kind::Switch(false);
    /// Whether the address comes from the network (DHCP).
    Dhcp: Communication, "SYSTem:COMMunicate:ETHernet:DHCP", Kind::Switch(false);
    /// The active interface.
    Interface: Communication, "SYSTem:COMMunicate:SELect", Kind::Choice(&["ETHernet", "GPIB", "SERial"]);
}
