//! Execution of each command. Every match is exhaustive: a new command does not compile until it is handled.

mod measure;
mod system;

use std::time::Duration;

use scpi::{ChannelList, Common, ParseError};
use survey::Relay;

use crate::command::{Command, Route, TriggerSource};
use crate::simulator::errors::Trouble;
use crate::simulator::relays::Moves;
use crate::simulator::{Session, Simulator34980a, Wires};

/// Context of the execution of a received command.
pub(crate) struct Turn<'a> {
    pub(super) session: Session,
    pub(super) now: Duration,
    /// This session has an unread reply already.
    pub(super) replied: bool,
    /// The command is the last of its message.
    pub(super) last: bool,
    /// Nesting depth of sequences; 0 outside.
    pub(super) depth: u32,
    pub(super) wires: &'a mut dyn Wires,
}

/// The reply to a query; `None` for a command.
type Reply = Result<Option<String>, Trouble>;

fn yes_no(yes: bool) -> Reply {
    Ok(Some(u8::from(yes).to_string()))
}

impl Simulator34980a {
    /// Executes one command. Advances the context's time by the time that the command takes.
    pub(crate) fn obey(&mut self, command: Command, turn: &mut Turn<'_>) -> Reply {
        match command {
            Command::Common(common) => self.obey_common(common, turn),
            Command::Route(route) => self.obey_route(route, turn),
            Command::Sense(sense) => self.obey_sense(sense, turn),
            Command::Functions(functions) => self.obey_functions(functions, turn),
            Command::Measure(measure) => self.obey_measure(measure, turn),
            Command::System(system) => self.obey_system(system, turn),
        }
    }

    fn obey_common(&mut self, common: Common, turn: &mut Turn<'_>) -> Reply {
        let signed = |value: u8| Ok(Some(format!("{value:+}")));
        match common {
            Common::Identify => {
                return Ok(Some(format!(
                    "{},34980A,{},2.43-2.43-0.00-0.00",
                    self.settings.vendor, self.settings.serial
                )));
            }
            Common::Reset => self.reset(turn),
            Common::ClearStatus => {
                self.status.clear();
                self.errors.clear();
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
                    .status_byte(!self.errors.is_empty(), turn.replied);
                return signed(byte);
            }
            Common::OperationComplete => self.completion_awaited = true,
            Common::WhenComplete => {
                self.wait_for_everything(turn);
                return Ok(Some("1".to_owned()));
            }
            Common::Wait => self.wait_for_everything(turn),
            Common::SelfTest => return signed(0),
            Common::Trigger => self.meter.trigger(TriggerSource::Bus, turn.now)?,
        }
        Ok(None)
    }

    pub(crate) fn reset(&mut self, turn: &mut Turn<'_>) {
        self.sequences.abort();
        self.stop_measuring(turn.now, turn.wires);
        self.meter.as_new();
        self.completion_awaited = false;
        self.overlap = false;
        self.display.clear();
        self.relays.reset_protection();
        let moves = self.relays.open(|_| true);
        self.moved(moves, turn);
    }

    fn obey_route(&mut self, route: Route, turn: &mut Turn<'_>) -> Reply {
        match route {
            Route::Close(list) => {
                self.wait_for_sequence(turn);
                let relays = self.relays.expand(&list)?;
                let moves = self.relays.close(&relays, self.meter.scan_list())?;
                self.moved(moves, turn);
            }
            Route::ClosePair(list) => {
                self.wait_for_sequence(turn);
                let relays = self.relays.expand_pairs(&list)?.concat();
                let moves = self.relays.close(&relays, self.meter.scan_list())?;
                self.moved(moves, turn);
            }
            Route::CloseExclusive(list) => {
                self.wait_for_sequence(turn);
                let relays = self.relays.expand(&list)?;
                let scan = self.meter.scan_list();
                let moves = self.relays.close_exclusive(&relays, scan)?;
                self.moved(moves, turn);
            }
            Route::Open(list) => {
                self.wait_for_sequence(turn);
                let relays = self.relays.expand_some(&list)?;
                let moves = self.relays.open(|relay| relays.contains(&relay));
                self.moved(moves, turn);
            }
            Route::OpenPair(list) => {
                self.wait_for_sequence(turn);
                let relays = self.relays.expand_pairs(&list)?.concat();
                let moves = self.relays.open(|relay| relays.contains(&relay));
                self.moved(moves, turn);
            }
            Route::OpenAll(slot) => {
                self.wait_for_sequence(turn);
                if let Some(slot) = slot {
                    self.relays.module(slot)?;
                }
                let meant = |relay: Relay| slot.is_none_or(|slot| relay.0 / 1000 == slot);
                let moves = self.relays.open(meant);
                self.moved(moves, turn);
            }
            Route::OpenBuses(bus) => {
                self.wait_for_sequence(turn);
                let moves = self.relays.open_buses(bus);
                self.moved(moves, turn);
            }
            Route::Closed(list) => return self.states(&list, true, turn),
            Route::Opened(list) => return self.states(&list, false, turn),
            Route::ClosedPair(list) => return self.pair_states(&list, true, turn),
            Route::OpenedPair(list) => return self.pair_states(&list, false, turn),
            Route::SetOverlap(on) => self.overlap = on,
            Route::Overlap => return yes_no(self.overlap),
            Route::ModuleBusy(slot) => {
                self.check_slot(slot)?;
                return yes_no(self.relays.settled_at(slot) > turn.now);
            }
            Route::ModuleWait(slot) => {
                self.check_slot(slot)?;
                turn.now = turn.now.max(self.relays.settled_at(slot));
            }
            Route::SetScan(list) => {
                let relays = self.relays.expand(&list)?;
                self.wait_for_measurement(turn)?;
                self.meter.set_scan(&self.relays, relays)?;
            }
            Route::AddScan(list) => {
                let more = self.relays.expand_some(&list)?;
                self.wait_for_measurement(turn)?;
                let scan = [self.meter.scan_list(), &more].concat();
                self.meter.set_scan(&self.relays, scan)?;
            }
            Route::RemoveScan(list) => {
                let less = self.relays.expand_some(&list)?;
                self.wait_for_measurement(turn)?;
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
                self.wait_for_measurement(turn)?;
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
            Route::Run(name) if turn.depth == 0 => self.sequences.run(&name, turn.now)?,
            Route::Run(name) => self.sequences.run_within(&name, turn.depth)?,
            Route::Delete(name) => self.sequences.delete(name.as_deref())?,
            Route::Catalog => return Ok(Some(self.sequences.catalog())),
            Route::SequenceBusy => return yes_no(self.sequences.is_running()),
            Route::SequenceWait => self.end_sequence(turn),
            Route::SequenceAbort => self.sequences.abort(),
        }
        Ok(None)
    }

    /// Aborts the running measurement; a reply that waits for it gets the readings taken so far.
    pub(crate) fn stop_measuring(&mut self, at: Duration, wires: &mut dyn Wires) {
        self.meter.abort(at, &mut self.relays, wires);
        self.settle_deferred(false);
    }

    fn check_slot(&self, slot: Option<u32>) -> Result<(), Trouble> {
        match slot {
            Some(slot) => self.relays.module(slot).map(drop),
            None => Ok(()),
        }
    }

    fn states(&mut self, list: &ChannelList, closed: bool, turn: &mut Turn<'_>) -> Reply {
        self.wait_for_sequence(turn);
        let relays = self.relays.expand_some(list)?;
        let is = |relay| self.relays.closed().contains(relay) == closed;
        let states = relays.iter().map(|relay| u8::from(is(relay)).to_string());
        Ok(Some(join(states)))
    }

    fn pair_states(&mut self, list: &ChannelList, closed: bool, turn: &mut Turn<'_>) -> Reply {
        self.wait_for_sequence(turn);
        let pairs = self.relays.expand_pairs(list)?;
        let is = |relay: &Relay| self.relays.closed().contains(relay) == closed;
        let states = pairs
            .iter()
            .map(|pair| u8::from(pair.iter().all(is)).to_string());
        Ok(Some(join(states)))
    }

    /// Relays are moving; unless commands may overlap, the next one waits until they have settled.
    fn moved(&mut self, moves: Moves, turn: &mut Turn<'_>) {
        let settled = self.relays.settle(moves, turn.now);
        self.relays.tell(settled, turn.wires);
        if !self.overlap {
            turn.now = settled.max(turn.now + moves.longest());
        }
    }

    /// Waits for the end of the running measurement.
    pub(crate) fn wait_for_measurement(&mut self, turn: &mut Turn<'_>) -> Result<(), Trouble> {
        if self.meter.is_endless() {
            return Err(ParseError::SettingsConflict.into());
        }
        if let Some(end) = self.meter.ends_at()
            && end > turn.now
        {
            self.pass(end, turn.wires);
            turn.now = end;
        }
        Ok(())
    }

    /// Without overlap commands are executed one after the other; those of a sequence come before those that follow it.
    fn wait_for_sequence(&mut self, turn: &mut Turn<'_>) {
        if turn.depth == 0 && !self.overlap {
            self.end_sequence(turn);
        }
    }

    fn end_sequence(&mut self, turn: &mut Turn<'_>) {
        while let Some(due) = self.sequences.due() {
            turn.now = turn.now.max(due);
            self.pass(turn.now, turn.wires);
        }
    }

    fn wait_for_everything(&mut self, turn: &mut Turn<'_>) {
        self.end_sequence(turn);
        if !self.meter.is_endless()
            && let Some(end) = self.meter.ends_at()
        {
            turn.now = turn.now.max(end);
        }
        turn.now = turn.now.max(self.relays.settled_at(None));
    }
}

/// A definite block.
fn block(text: &str) -> String {
    let block = scpi::format_block(text.as_bytes());
    String::from_utf8_lossy(&block).into_owned()
}

fn join(texts: impl Iterator<Item = String>) -> String {
    texts.collect::<Vec<_>>().join(",")
}
