//! Execution of each command. Every match is exhaustive, so that a new command does not compile until it is handled.

mod calculate;
mod measure;
mod system;

use std::time::Duration;

use scpi::{ChannelList, Common, ParseError};
use survey::Relay;

use crate::command::{Command, Route, TriggerSource};
use crate::simulator::errors::QueuedError;
use crate::simulator::relays::MoveTimes;
use crate::simulator::{Session, Simulator34980a, Wires};

/// Context of the execution of a received command.
pub(crate) struct Execution<'a> {
    pub(super) session: Session,
    pub(super) now: Duration,
    /// Whether an earlier query of this message has a reply.
    pub(super) replied: bool,
    /// Whether the command is the last of its message.
    pub(super) last: bool,
    /// Nesting depth of sequences; 0 outside.
    pub(super) depth: u32,
    pub(super) wires: &'a mut dyn Wires,
}

/// The reply to a query; `None` for a command.
type Reply = Result<Option<String>, QueuedError>;

fn yes_no(yes: bool) -> Reply {
    Ok(Some(u8::from(yes).to_string()))
}

impl Simulator34980a {
    /// Executes one command. Advances the context's time by the time that the command takes.
    pub(crate) fn execute(&mut self, command: Command, execution: &mut Execution<'_>) -> Reply {
        match command {
            Command::Common(common) => self.execute_common(common, execution),
            Command::Route(route) => self.execute_route(route, execution),
            Command::Sense(sense) => self.execute_sense(sense, execution),
            Command::Functions(functions) => self.execute_functions(functions, execution),
            Command::Measure(measure) => self.execute_measure(measure, execution),
            Command::Calculate(calculate) => self.execute_calculate(calculate, execution),
            Command::System(system) => self.execute_system(system, execution),
        }
    }

    fn execute_common(&mut self, common: Common, execution: &mut Execution<'_>) -> Reply {
        let signed = |value: u8| Ok(Some(format!("{value:+}")));
        match common {
            Common::Identify => {
                return Ok(Some(format!(
                    "{},34980A,{},2.43-2.43-0.00-0.00",
                    self.settings.vendor, self.settings.serial
                )));
            }
            Common::Reset => self.reset(execution),
            Common::ClearStatus => {
                self.status.clear();
                self.errors.clear();
                self.clear_alarms();
                self.completion_awaited = false;
            }
            Common::SetEventEnable(mask) => self.status.set_standard_enable(mask),
            Common::EventEnable => return signed(self.status.standard_enable()),
            Common::Events => return signed(self.status.take_standard()),
            Common::SetServiceEnable(mask) => self.status.set_service_enable(mask),
            Common::ServiceEnable => return signed(self.status.service_enable()),
            Common::StatusByte => {
                let byte = self
                    .status
                    .status_byte(!self.errors.is_empty(), execution.replied);
                return signed(byte);
            }
            Common::OperationComplete => self.completion_awaited = true,
            Common::WhenComplete => {
                self.wait_for_everything(execution);
                return Ok(Some("1".to_owned()));
            }
            Common::Wait => self.wait_for_everything(execution),
            Common::SelfTest => return signed(0),
            Common::Trigger => self.meter.trigger(TriggerSource::Bus, execution.now)?,
        }
        Ok(None)
    }

    pub(crate) fn reset(&mut self, execution: &mut Execution<'_>) {
        self.sequences.abort();
        self.stop_measuring(execution.now, execution.wires);
        self.meter.as_new();
        self.completion_awaited = false;
        self.overlap = false;
        self.display.clear();
        self.display_on = true;
        self.relays.reset_protection();
        let moves = self.relays.open(|_, _| true);
        self.moved(moves, execution);
    }

    fn execute_route(&mut self, route: Route, execution: &mut Execution<'_>) -> Reply {
        match route {
            Route::Close(list) => {
                self.wait_for_sequence(execution);
                let relays = self.relays.expand(&list)?;
                let moves = self.relays.close(&relays, self.meter.scan_list())?;
                self.moved(moves, execution);
            }
            Route::ClosePair(list) => {
                self.wait_for_sequence(execution);
                let relays = self.relays.expand_pairs(&list)?.concat();
                let moves = self.relays.close(&relays, self.meter.scan_list())?;
                self.moved(moves, execution);
            }
            Route::CloseExclusive(list) => {
                self.wait_for_sequence(execution);
                let relays = self.relays.expand(&list)?;
                let scan = self.meter.scan_list();
                let moves = self.relays.close_exclusive(&relays, scan)?;
                self.moved(moves, execution);
            }
            Route::Open(list) => {
                self.wait_for_sequence(execution);
                let relays = self.relays.expand_some(&list)?;
                let moves = self.relays.open(|_, relay| relays.contains(&relay));
                self.moved(moves, execution);
            }
            Route::OpenPair(list) => {
                self.wait_for_sequence(execution);
                let relays = self.relays.expand_pairs(&list)?.concat();
                let moves = self.relays.open(|_, relay| relays.contains(&relay));
                self.moved(moves, execution);
            }
            Route::OpenAll(slot) => {
                self.wait_for_sequence(execution);
                if let Some(slot) = slot {
                    self.relays.module(slot)?;
                }
                let relays = &mut self.relays;
                let moves = relays.open(|_, relay| slot.is_none_or(|slot| relay.0 / 1000 == slot));
                self.moved(moves, execution);
            }
            Route::OpenBuses(bus) => {
                self.wait_for_sequence(execution);
                let moves = self.relays.open_buses(bus);
                self.moved(moves, execution);
            }
            Route::Closed(list) => return self.states(&list, true, execution),
            Route::Opened(list) => return self.states(&list, false, execution),
            Route::ClosedPair(list) => return self.pair_states(&list, true, execution),
            Route::OpenedPair(list) => return self.pair_states(&list, false, execution),
            Route::SetOverlap(on) => self.overlap = on,
            Route::Overlap => return yes_no(self.overlap),
            Route::ModuleBusy(slot) => {
                self.check_slot(slot)?;
                return yes_no(self.relays.settled_at(slot) > execution.now);
            }
            Route::ModuleWait(slot) => {
                self.check_slot(slot)?;
                execution.now = execution.now.max(self.relays.settled_at(slot));
            }
            Route::SetScan(list) => {
                let relays = self.relays.expand(&list)?;
                self.wait_for_measurement(execution)?;
                self.meter.set_scan(&self.relays, relays)?;
            }
            Route::AddScan(list) => {
                let more = self.relays.expand_some(&list)?;
                self.wait_for_measurement(execution)?;
                let scan = [self.meter.scan_list(), &more].concat();
                self.meter.set_scan(&self.relays, scan)?;
            }
            Route::RemoveScan(list) => {
                let less = self.relays.expand_some(&list)?;
                self.wait_for_measurement(execution)?;
                let stays = |relay: &&Relay| !less.contains(relay);
                let scan = self.meter.scan_list().iter().filter(stays).copied();
                self.meter.set_scan(&self.relays, scan.collect())?;
            }
            Route::Scan => {
                let list = ChannelList::of(self.meter.scan_list().iter().map(|r| r.0));
                return Ok(Some(block(&list.to_string())));
            }
            Route::ScanSize => return Ok(Some(format!("{:+}", self.meter.scan_list().len()))),
            Route::SetOrdered(on) => {
                self.wait_for_measurement(execution)?;
                self.meter.set_ordered(&self.relays, on)?;
            }
            Route::Ordered => return yes_no(self.meter.ordered()),
            Route::SetLabel(label, list) => {
                for relay in self.relays.expand_some(&list)? {
                    self.labels.insert(relay, label.clone());
                }
            }
            Route::Labels(list) => {
                let relays = self.relays.expand_some(&list)?;
                let label = |relay: &Relay| self.labels.get(relay).map_or("", String::as_str);
                let labels = relays.iter().map(|relay| scpi::quote(label(relay)));
                return Ok(Some(join(labels)));
            }
            Route::Define { name, commands } => self.sequences.define(name, commands)?,
            Route::Definition(name) => return self.sequences.definition(&name).map(Some),
            Route::Run(name) if execution.depth == 0 => self.sequences.run(&name, execution.now)?,
            Route::Run(name) => self.sequences.run_within(&name, execution.depth)?,
            Route::Delete(name) => self.sequences.delete(name.as_deref())?,
            Route::Catalog => return Ok(Some(self.sequences.catalog())),
            Route::SequenceBusy => return yes_no(self.sequences.is_running()),
            Route::SequenceWait => self.end_sequence(execution),
            Route::SequenceAbort => self.sequences.abort(),
        }
        Ok(None)
    }

    /// Aborts the running measurement; a reply that waits for it gets the readings taken so far.
    pub(crate) fn stop_measuring(&mut self, at: Duration, wires: &mut dyn Wires) {
        self.meter.abort(at, &mut self.relays, wires);
        self.settle_deferred(false);
        self.free_deferred();
    }

    fn check_slot(&self, slot: Option<u32>) -> Result<(), QueuedError> {
        match slot {
            Some(slot) => self.relays.module(slot).map(drop),
            None => Ok(()),
        }
    }

    fn states(&mut self, list: &ChannelList, closed: bool, execution: &mut Execution<'_>) -> Reply {
        self.wait_for_sequence(execution);
        let relays = self.relays.expand_some(list)?;
        let is = |relay| self.relays.closed().contains(relay) == closed;
        let states = relays.iter().map(|relay| u8::from(is(relay)).to_string());
        Ok(Some(join(states)))
    }

    fn pair_states(
        &mut self,
        list: &ChannelList,
        closed: bool,
        execution: &mut Execution<'_>,
    ) -> Reply {
        self.wait_for_sequence(execution);
        let pairs = self.relays.expand_pairs(list)?;
        let is = |relay: &Relay| self.relays.closed().contains(relay) == closed;
        let states = pairs
            .iter()
            .map(|pair| u8::from(pair.iter().all(is)).to_string());
        Ok(Some(join(states)))
    }

    /// Starts the settling time of moved relays. Unless commands may overlap, the next command waits until they have
    /// settled.
    fn moved(&mut self, moves: MoveTimes, execution: &mut Execution<'_>) {
        let settled = self.relays.settle(moves, execution.now);
        self.relays.tell(settled, execution.wires);
        if !self.overlap {
            execution.now = settled.max(execution.now + moves.longest());
        }
    }

    /// Waits for the end of the running measurement.
    pub(crate) fn wait_for_measurement(
        &mut self,
        execution: &mut Execution<'_>,
    ) -> Result<(), QueuedError> {
        if self.meter.is_endless() {
            return Err(ParseError::SettingsConflict.into());
        }
        if let Some(end) = self.meter.ends_at()
            && end > execution.now
        {
            self.pass(end, execution.wires);
            execution.now = end;
        }
        Ok(())
    }

    /// Without overlap, executes the commands of a running sequence before a command that follows the sequence.
    fn wait_for_sequence(&mut self, execution: &mut Execution<'_>) {
        if execution.depth == 0 && !self.overlap {
            self.end_sequence(execution);
        }
    }

    fn end_sequence(&mut self, execution: &mut Execution<'_>) {
        while let Some(due) = self.sequences.due() {
            execution.now = execution.now.max(due);
            self.pass(execution.now, execution.wires);
        }
    }

    fn wait_for_everything(&mut self, execution: &mut Execution<'_>) {
        self.end_sequence(execution);
        if !self.meter.is_endless()
            && let Some(end) = self.meter.ends_at()
        {
            execution.now = execution.now.max(end);
        }
        execution.now = execution.now.max(self.relays.settled_at(None));
    }
}

/// Formats a text as a definite block.
fn block(text: &str) -> String {
    let block = scpi::format_block(text.as_bytes());
    String::from_utf8_lossy(&block).into_owned()
}

fn join(texts: impl Iterator<Item = String>) -> String {
    texts.collect::<Vec<_>>().join(",")
}
