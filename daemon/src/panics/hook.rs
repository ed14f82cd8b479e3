//! The panic hook. It logs a contained panic, and reports every other one to whoever listens.

use std::sync::{LazyLock, Once};

use tokio::sync::watch;

use crate::panics::containment;

/// Where the last panic happened that was not contained.
static RECEIVED: LazyLock<watch::Sender<String>> = LazyLock::new(watch::Sender::default);
static INSTALLED: Once = Once::new();

/// Installs the hook, before the one that prints.
pub(crate) fn install() {
    INSTALLED.call_once(|| {
        let prints = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if containment::is_contained() {
                return containment::log(panic);
            }
            let place = panic
                .location()
                .map_or_else(|| "nowhere".to_owned(), ToString::to_string);
            RECEIVED.send_replace(place);
            prints(panic);
        }));
    });
}

/// Receives the place of each panic from now on.
pub(crate) fn listen() -> watch::Receiver<String> {
    RECEIVED.subscribe()
}
