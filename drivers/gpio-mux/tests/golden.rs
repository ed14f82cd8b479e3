//! Conversations from the fact sheet (`instruments/gpio-mux.md`): `>` is sent, `<` is the reply. They test the grammar
//! that driver and simulator share.

use std::time::Duration;

use gpio_mux::{Poles, Settings, SimulatorGpioMux};
use survey::Electrode;

struct Nowhere;

impl Poles for Nowhere {
    fn poles(&mut self, _: [Option<Electrode>; 4], _: Duration) {}
}

fn holds(conversation: &str) {
    let mut board = SimulatorGpioMux::new(Settings::default());
    let mut answer = None;
    for line in conversation.lines().map(str::trim) {
        match line.split_at_checked(1) {
            Some((">", line)) => {
                answer = board
                    .receive(line.trim(), Duration::ZERO, &mut Nowhere)
                    .text;
            }
            Some(("<", expected)) => {
                assert_eq!(
                    answer.as_deref(),
                    Some(expected.trim()),
                    "in\n{conversation}"
                );
            }
            _ => assert!(line.is_empty(), "'{line}' begins with neither > nor <"),
        }
    }
}

#[test]
fn section_5_one_reply_per_command() {
    holds(
        "> *IDN?
         < Tactus,GPIO-MUX,0001,1.0
         > STAT?
         < OFF,OFF,OFF,OFF
         > LAST?
         < 0
         > SET I+ 17
         < 17,OFF,OFF,OFF
         > LAST?
         < 1
         > PAIR V 3
         < 17,OFF,3,4
         > PAIR I 26
         < 26,1,3,4
         > set v- off
         < 26,1,3,OFF
         > WDOG 0
         < 26,1,3,OFF
         > OFF
         < OFF,OFF,OFF,OFF
         > SYST:ERR?
         < +0,\"No error\"",
    );
}

#[test]
fn section_3_illegal_requests_are_refused_before_any_change() {
    holds(
        "> PAIR I 1
         < 1,2,OFF,OFF
         > SET I- 1
         < ERR -221,\"Settings conflict; electrode 1 would be on I+ and on I-\"
         > STAT?
         < 1,2,OFF,OFF
         > SET V+ 1
         < 1,2,1,OFF
         > SET V- 1
         < 1,2,1,1
         > SET I+ 27
         < ERR -222,\"Data out of range; electrode 27 of 26\"
         > SET I+ 0
         < ERR -222,\"Data out of range; electrodes count from 1\"
         > SET X 1
         < ERR -224,\"Illegal parameter value; I+, I-, V+ or V-\"
         > SET I+
         < ERR -109,\"Missing parameter\"
         > SET I+ 1 2
         < ERR -108,\"Parameter not allowed\"
         > SCAN V
         < ERR -113,\"Undefined header\"
         > SYST:ERR?
         < -221,\"Settings conflict; electrode 1 would be on I+ and on I-\"
         > STAT?
         < 1,2,1,1",
    );
}

#[test]
fn section_5_numbers_that_cannot_be_and_the_queue_as_in_scpi() {
    holds(
        "> SET V- -1
         < ERR -222,\"Data out of range; an electrode's number or OFF\"
         > SET V- 99999999999999999999999
         < ERR -222,\"Data out of range; an electrode's number or OFF\"
         > SET V- 1.5
         < ERR -104,\"Data type error; an electrode's number or OFF\"
         > SET V- +
         < ERR -104,\"Data type error; an electrode's number or OFF\"
         > WDOG -1
         < ERR -222,\"Data out of range; milliseconds\"
         > WDOG 4294967296
         < ERR -222,\"Data out of range; milliseconds\"
         > WDOG OFF
         < ERR -104,\"Data type error; milliseconds\"
         > PAIR I 27
         < ERR -222,\"Data out of range; electrode 27 of 26\"
         > :SYST:ERR:NEXT?
         < -222,\"Data out of range; an electrode's number or OFF\"
         > System:Err?
         < -222,\"Data out of range; an electrode's number or OFF\"
         > SYST:ERR? 1
         < ERR -108,\"Parameter not allowed\"
         > SYSTE:ERR?
         < ERR -113,\"Undefined header\"",
    );
}
