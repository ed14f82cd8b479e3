//! Sweeps and waves: arming, starting, ending, and the advance of time over them.

use std::time::Duration;

use super::plan::{plan_sweep, plan_wave};
use super::state::{Mode, Outcome, is_limited};
use super::sweep::{Sweep, Trigger};
use super::wave::Wave;
use super::{Simulator6221, status};
use crate::command::COMPLIANCE_BIT;
use crate::parameter::Subject;
use crate::{List, Load, Parameter};
use scpi::ParseError;

const BAUD_RATES: [f64; 10] = [
    300.0, 600.0, 1_200.0, 2_400.0, 4_800.0, 9_600.0, 19_200.0, 38_400.0, 57_600.0, 115_200.0,
];

impl Simulator6221 {
    pub(super) fn is_sweeping(&self) -> bool {
        matches!(&self.mode, Mode::Sweep(sweep) if sweep.is_running())
    }

    pub(super) fn is_waving(&self) -> bool {
        matches!(&self.mode, Mode::Wave(wave) if wave.is_running())
    }

    /// Remaining time of the pending operation. Zero without one, and for a wave without end; `None` for a sweep that
    /// waits for an event or has no end.
    pub(super) fn remaining(&self) -> Option<Duration> {
        match &self.mode {
            Mode::Source => Some(Duration::ZERO),
            Mode::Sweep(sweep) => sweep.remaining(self.now),
            Mode::Wave(wave) => Some(wave.remaining(self.now).unwrap_or_default()),
        }
    }

    /// Advances the time to `at`; an earlier time has no effect.
    pub(super) fn pass(&mut self, at: Duration, load: &mut dyn Load) {
        let before = self.now;
        self.now = self.now.max(at);
        if self.trips_at.is_some_and(|trip| trip <= self.now) {
            self.trips_at = None;
            self.stop_mode();
            self.panel.output = false;
        }
        let (now, panel) = (self.now, &mut self.panel);
        match &mut self.mode {
            Mode::Source => {}
            Mode::Sweep(sweep) if sweep.is_running() => {
                let resistance = panel.output.then(|| load.resistance(now));
                let limit = panel.compliance;
                let progress = sweep.advance(now, |point| {
                    let limit = point.limit.unwrap_or(limit);
                    resistance.is_some_and(|ohms| is_limited(point.level, ohms, limit))
                });
                if let Some(point) = sweep.point() {
                    (panel.level, panel.range) = (point.level, point.range);
                    panel.compliance = point.limit.unwrap_or(limit);
                }
                for (line, sent) in sweep.take_pulses() {
                    self.pulses[usize::from(line) - 1] += sent;
                }
                if progress.limited {
                    self.status.measurement.latch(COMPLIANCE_BIT);
                }
                if progress.aborted {
                    panel.output = false;
                    self.outcome = Outcome::SweepAborted;
                    self.mode = Mode::Source;
                } else if sweep.is_done() {
                    self.outcome = Outcome::SweepDone;
                }
            }
            Mode::Wave(wave) if wave.is_running() => {
                if self.values.is_on(Parameter::PhaseMarker) {
                    let marked = (self.values.get(Parameter::MarkedPhase) / 360.0).rem_euclid(1.0);
                    let marks = wave
                        .marked_phases(now, marked)
                        .saturating_sub(wave.marked_phases(before, marked));
                    // Lines are 1 to 6.
                    self.pulses[self.values.get(Parameter::MarkerLine) as usize - 1] += marks;
                }
                // The wave may have reached its peak between two evaluations.
                if panel.output && wave.has_peaked(now) {
                    let resistance = load.resistance(now);
                    if is_limited(wave.peak(), resistance, panel.compliance) {
                        self.status.measurement.latch(COMPLIANCE_BIT);
                    }
                }
                if wave.advance(now) {
                    // The output is off after the end of a wave (corrections of 2026-11-22); scripts poll for this.
                    panel.output = false;
                    self.outcome = Outcome::WaveStopped;
                }
            }
            Mode::Sweep(_) | Mode::Wave(_) => {}
        }
        self.show();
        if self.completion_awaited && self.remaining() == Some(Duration::ZERO) {
            self.completion_awaited = false;
            self.status.raise(scpi::StandardEvent::OperationComplete);
        }
    }

    /// Sets the conditions of the operation register (fact sheet, section 5).
    pub(super) fn show(&mut self) {
        let sweep = match &self.mode {
            Mode::Sweep(sweep) if sweep.is_running() => Some(sweep),
            _ => None,
        };
        let waving = self.is_waving();
        let register = &mut self.status.operation;
        register.set(status::SWEEPING, sweep.is_some());
        let awaits_trigger = sweep.is_some_and(|sweep| sweep.awaits_trigger());
        register.set(status::AWAITING_TRIGGER, awaits_trigger);
        let awaits_arm = sweep.is_some_and(|sweep| sweep.awaits_arm());
        register.set(status::AWAITING_ARM, awaits_arm);
        register.set(status::WAVE_STARTED, waving);
        register.set(status::IDLE, sweep.is_none() && !waving);
        register.set(status::SWEEP_DONE, self.outcome == Outcome::SweepDone);
        register.set(status::SWEEP_ABORTED, self.outcome == Outcome::SweepAborted);
        register.set(status::WAVE_STOPPED, self.outcome == Outcome::WaveStopped);
    }

    /// # Errors
    /// -221 for a parameter that a running sweep or wave uses, -224 for a baud rate that does not exist.
    pub(super) fn set_parameter(
        &mut self,
        parameter: Parameter,
        value: f64,
    ) -> Result<(), ParseError> {
        let held = match parameter.subject() {
            Subject::Sweep => self.is_sweeping(),
            Subject::Wave => self.is_waving(),
            Subject::LiveWave | Subject::Communication | Subject::Other => false,
        };
        if held {
            return Err(ParseError::SettingsConflict);
        }
        if parameter == Parameter::Baud && !BAUD_RATES.contains(&value) {
            return Err(ParseError::IllegalParameter);
        }
        if let Mode::Wave(wave) = &mut self.mode
            && parameter.subject() == Subject::LiveWave
            && wave.is_running()
        {
            let mut changed = wave.clone();
            match parameter {
                Parameter::Frequency => changed.retune(value, self.now),
                Parameter::Amplitude => changed.amplitude = value,
                _ => changed.offset = value,
            }
            if !changed.range.holds(changed.peak()) {
                return Err(ParseError::SettingsConflict);
            }
            *wave = changed;
        }
        self.values.set(parameter, value);
        Ok(())
    }

    /// # Errors
    /// -221 while a sweep or wave uses the list.
    pub(super) fn is_free_to_change(&self, list: List) -> Result<(), ParseError> {
        let held = match list {
            List::Levels | List::Delays | List::Limits => self.is_sweeping(),
            List::Wave => self.is_waving(),
        };
        if held {
            Err(ParseError::SettingsConflict)
        } else {
            Ok(())
        }
    }

    /// # Errors
    /// -230 for an arbitrary wave that was never set.
    pub(super) fn read_list(&self, list: List) -> Result<String, ParseError> {
        if self.lists.get(list).is_empty() {
            return Err(ParseError::DataStale);
        }
        Ok(self.lists.read(list))
    }

    /// Arms a sweep. This switches the output on (assumed) at the present level, until the sweep is started.
    ///
    /// # Errors
    /// -221 for settings that define no valid sweep.
    pub(super) fn arm_sweep(&mut self) -> Result<(), ParseError> {
        self.is_free_to_arm()?;
        self.mode = Mode::Sweep(Box::new(self.planned_sweep()?));
        self.outcome = Outcome::None;
        self.panel.output = true;
        Ok(())
    }

    fn planned_sweep(&self) -> Result<Sweep, ParseError> {
        let points = plan_sweep(&self.values, &self.lists, self.panel.range)?;
        let sweep = Sweep::new(points, &self.values);
        // no other instrument can send a trigger on a line that is an output
        if sweep.receives_own_output() {
            return Err(ParseError::SettingsConflict);
        }
        Ok(sweep)
    }

    fn is_free_to_arm(&self) -> Result<(), ParseError> {
        if self.is_sweeping() || self.is_waving() || !self.interlock_closed {
            return Err(ParseError::SettingsConflict);
        }
        Ok(())
    }

    /// Starts the sweep with the present settings.
    ///
    /// # Errors
    /// -221 if no sweep is armed, the interlock is open, or the settings no longer define a valid sweep; -213 while one
    /// is running.
    pub(super) fn initiate(&mut self) -> Result<(), ParseError> {
        match &self.mode {
            Mode::Sweep(sweep) if sweep.is_running() => Err(ParseError::InitIgnored),
            Mode::Sweep(_) if self.interlock_closed => {
                let mut sweep = self.planned_sweep()?;
                sweep.start(self.now);
                self.mode = Mode::Sweep(Box::new(sweep));
                self.outcome = Outcome::None;
                self.panel.output = true;
                Ok(())
            }
            _ => Err(ParseError::SettingsConflict),
        }
    }

    /// Ends an armed or running sweep and switches the output off (assumed); after a finished sweep the output stays on
    /// at the last point.
    pub(super) fn abort_sweep(&mut self) {
        if let Mode::Sweep(sweep) = &self.mode {
            let rests = sweep.is_done();
            self.stop_mode();
            self.panel.output &= rests;
        }
    }

    fn sweep_mut(&mut self) -> Option<&mut Sweep> {
        match &mut self.mode {
            Mode::Sweep(sweep) => Some(sweep),
            Mode::Source | Mode::Wave(_) => None,
        }
    }

    pub(super) fn receive_trigger(&mut self, event: Trigger) -> bool {
        let now = self.now;
        self.sweep_mut()
            .is_some_and(|sweep| sweep.receive(event, now))
    }

    pub(super) fn signal_arm(&mut self) -> Result<(), ParseError> {
        let now = self.now;
        let received = self.sweep_mut().is_some_and(|sweep| sweep.signal_arm(now));
        received.then_some(()).ok_or(ParseError::TriggerIgnored)
    }

    pub(super) fn signal_trigger(&mut self) -> Result<(), ParseError> {
        let now = self.now;
        let received = self
            .sweep_mut()
            .is_some_and(|sweep| sweep.signal_trigger(now));
        received.then_some(()).ok_or(ParseError::TriggerIgnored)
    }

    /// # Errors
    /// -221 for settings that define no valid wave.
    pub(super) fn arm_wave(&mut self) -> Result<(), ParseError> {
        self.is_free_to_arm()?;
        self.mode = Mode::Wave(Box::new(self.planned_wave()?));
        self.outcome = Outcome::None;
        Ok(())
    }

    fn planned_wave(&self) -> Result<Wave, ParseError> {
        if self.values.is_on(Parameter::ExternalTrigger) {
            return Err(ParseError::SettingsConflict);
        }
        plan_wave(&self.values, &self.lists, &self.waves, self.panel.range)
    }

    /// Starts the wave with the present settings.
    ///
    /// # Errors
    /// -221 if no wave is armed, the interlock is open, or the settings no longer define a valid wave; -213 while one
    /// is running.
    pub(super) fn start_wave(&mut self) -> Result<(), ParseError> {
        match &self.mode {
            Mode::Wave(wave) if wave.is_running() => Err(ParseError::InitIgnored),
            Mode::Wave(_) if self.interlock_closed => {
                let mut wave = self.planned_wave()?;
                wave.start(self.now);
                self.mode = Mode::Wave(Box::new(wave));
                self.outcome = Outcome::None;
                self.panel.output = true;
                Ok(())
            }
            _ => Err(ParseError::SettingsConflict),
        }
    }

    /// Ends an armed or running wave and switches the output off (assumed).
    pub(super) fn abort_wave(&mut self) {
        if matches!(self.mode, Mode::Wave(_)) {
            self.stop_mode();
            self.panel.output = false;
        }
    }

    /// # Errors
    /// -230 if no arbitrary wave was set.
    pub(super) fn copy_wave(&mut self, place: u8) -> Result<(), ParseError> {
        let points = self.lists.get(List::Wave);
        if points.is_empty() {
            return Err(ParseError::DataStale);
        }
        // Memories are numbered from 1 to 4.
        self.waves[usize::from(place) - 1] = points.to_vec();
        Ok(())
    }
}
