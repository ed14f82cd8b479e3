//! Describes a failed frame: the cause, the state of the source, the step, and further causes; each cause once.

use rig::{AcquireError, EndReason, LinkError, RigError};

/// Text about a failed frame. The first sentence gives the cause with the instrument, and whether the source is
/// verified off. The rest gives the step and further causes.
pub(crate) fn describe(error: &AcquireError) -> String {
    let Some(cause) = error.cause() else {
        return survey::error_chain(error);
    };
    let mut text = format!("{}; {}", what(cause), safety(error));
    let at = match &error.reason {
        EndReason::Step(number, step, _) => format!("at step {number} ({step})"),
        _ => "while the survey was being prepared".to_owned(),
    };
    text.push_str(&format!(". It happened {at}"));
    let mut reported = vec![what(cause)];
    let mut reasons: Vec<String> = why(cause).into_iter().collect();
    if let Some(cleanup) = error.cleanup() {
        // an instrument whose connection was lost also fails in the cleanup; the loss is reported once
        let same_wire = |other: &&RigError| !(is_wire(cause) && is_wire(other));
        let failed = [&cleanup.source, &cleanup.relays].into_iter().flatten();
        reasons.extend(failed.filter(same_wire).map(what));
    }
    for reason in reasons {
        if !reported.contains(&reason) {
            text.push_str(&format!("; {reason}"));
            reported.push(reason);
        }
    }
    text
}

/// The event, and the instrument concerned.
fn what(cause: &RigError) -> String {
    match cause {
        RigError::Link(LinkError::Lost { instrument, .. }) => {
            format!("the connection to {instrument} was lost")
        }
        RigError::Link(LinkError::Timeout {
            instrument,
            deadline,
            ..
        }) => format!("{instrument} did not answer within {deadline:?}"),
        other => other.to_string(),
    }
}

/// Further details: the message in progress, and the error of the operating system.
fn why(cause: &RigError) -> Option<String> {
    match cause {
        RigError::Link(LinkError::Lost { message, cause, .. }) => {
            let under_way = (!message.is_empty()).then(|| format!("the message was '{message}'"));
            let system = cause.as_ref().map(ToString::to_string);
            let parts: Vec<String> = under_way.into_iter().chain(system).collect();
            (!parts.is_empty()).then(|| parts.join(", "))
        }
        RigError::Link(LinkError::Timeout { message, .. }) if !message.is_empty() => {
            Some(format!("the message was '{message}'"))
        }
        _ => None,
    }
}

fn is_wire(error: &RigError) -> bool {
    matches!(error, RigError::Link(_))
}

fn safety(error: &AcquireError) -> String {
    let after = error.off_after().map_or_else(String::new, |after| {
        format!(" {:.1} ms after its detection", after.as_secs_f64() * 1e3)
    });
    let cleanup = error.cleanup();
    match cleanup.map(|cleanup| (&cleanup.source, &cleanup.relays)) {
        None | Some((None, None)) => {
            format!("the source is off, verified{after}, and the relays are open")
        }
        Some((Some(_), None)) => {
            "the source is NOT verified off, but the injecting relays are open: the sheet carries no current"
                .to_owned()
        }
        Some((None, Some(_))) => {
            format!("the source is off, verified{after}, but the relays are NOT verified open")
        }
        Some((Some(_), Some(_))) => {
            "the source is NOT verified off and the relays are NOT verified open: treat the sheet as live".to_owned()
        }
    }
}

#[cfg(test)]
mod tests {
    use rig::CleanupError;

    use crate::acquisition::failed_frame::*;

    fn lost(instrument: &str, message: &str) -> RigError {
        RigError::Link(LinkError::Lost {
            instrument: instrument.to_owned(),
            message: message.to_owned(),
            cause: Some(std::io::ErrorKind::ConnectionReset.into()),
        })
    }

    #[test]
    fn what_matters_comes_first_and_each_cause_once() {
        let text = describe(&AcquireError {
            reason: EndReason::Prepare(lost("6221 (tcp:h:1)", "")),
            made_safe: Err(CleanupError {
                source: Some(lost("6221 (tcp:h:1)", "OUTP OFF")),
                relays: None,
                off_after: None,
            }),
        });
        assert_eq!(
            text,
            "the connection to 6221 (tcp:h:1) was lost; the source is NOT verified off, but the injecting relays are \
             open: the sheet carries no current. It happened while the survey was being prepared; connection reset"
        );
    }

    #[test]
    fn possibly_live_sheet_is_reported_first() {
        let silent = || {
            RigError::Link(LinkError::Timeout {
                instrument: "34980A (tcp:h:2)".to_owned(),
                message: "ROUT:OPEN (@1001)".to_owned(),
                deadline: std::time::Duration::from_secs(5),
            })
        };
        let not_off = RigError::NotOff {
            instrument: "6221 (tcp:h:1)".to_owned(),
            output: "on".to_owned(),
            level: survey::Amps(1e-3),
        };
        let text = describe(&AcquireError {
            reason: EndReason::Prepare(silent()),
            made_safe: Err(CleanupError {
                source: Some(not_off),
                relays: Some(silent()),
                off_after: None,
            }),
        });
        let first = text.split(". ").next().unwrap();
        assert!(
            first.starts_with("34980A (tcp:h:2) did not answer within 5s"),
            "{text}"
        );
        assert!(first.ends_with("treat the sheet as live"), "{text}");
        assert_eq!(text.matches("did not answer").count(), 1, "{text}");
        assert!(
            text.contains("6221 (tcp:h:1): the source could not be verified off"),
            "{text}"
        );
    }
}
