//! Resynchronises a link: the peer must echo numbers that were just sent.

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

use crate::link::{Link, LinkError, State};

impl<S: AsyncRead + AsyncWrite + Unpin + Send> Link<S> {
    /// Resynchronises a link whose connection cannot be replaced. Writes two numbers in turn to the event enable
    /// register, which every IEEE 488.2 instrument has, and waits until each is read back; everything received before
    /// is discarded. The register is then restored to its original value, or to 0 (its value at power-on) if the
    /// original value was never received. A failed attempt may be repeated.
    ///
    /// # Errors
    /// A lost connection, or a timeout; the link stays unsynchronised.
    pub async fn resynchronise(&mut self) -> Result<(), LinkError> {
        let first = self.next_nonce();
        let second = self.next_nonce();
        self.state = State::Unsynchronised;
        self.end_partial_message().await?;

        // Half a line may have been received before: the reply to this query completes it and is discarded with it.
        let until = Instant::now() + self.deadline;
        self.write("*ESE?", self.deadline, until).await?;

        self.nonces.extend([first, second]);
        let sent_so_far = self.nonces.clone();
        let mut found = self.enable;
        let echoed = self
            .await_echo(&format!("*ESE?;*ESE {first};*ESE?"), |line| {
                let (before, now) = two_numbers(line)?;
                // `before` is the original value unless it is a number written by this or an earlier attempt.
                let turn = sent_so_far.iter().position(|number| *number == now)?;
                if !sent_so_far[..turn].contains(&before) {
                    found.get_or_insert(before);
                }
                (now == first).then_some(())
            })
            .await;
        self.enable = found;
        echoed?;
        self.await_echo(&format!("*ESE?;*ESE {second};*ESE?"), |line| {
            (two_numbers(line)? == (first, second)).then_some(())
        })
        .await?;
        let before = self.enable.unwrap_or(0);
        self.await_echo(&format!("*ESE {before};*ESE?"), |line| {
            (line.trim().parse() == Ok(before)).then_some(())
        })
        .await?;
        self.confirm_synchronised("*ESE?").await?;
        self.nonces.clear();
        self.enable = None;
        Ok(())
    }

    /// Like [`Link::resynchronise`] for a peer without `*ESE`: sends each message in turn and discards lines until its
    /// expected reply arrives. Needs at least two messages, whose replies no earlier query can have had.
    ///
    /// # Errors
    /// A lost connection, or an expected reply missing at the timeout; the link stays unsynchronised.
    pub async fn resynchronise_by(&mut self, probes: &[(&str, &str)]) -> Result<(), LinkError> {
        self.state = State::Unsynchronised;
        self.end_partial_message().await?;
        for (message, expected) in probes {
            self.await_echo(message, |line| (line.trim() == *expected).then_some(()))
                .await?;
        }
        self.confirm_synchronised("").await
    }

    /// Ends a message that a cancelled write left incomplete.
    async fn end_partial_message(&mut self) -> Result<(), LinkError> {
        let until = Instant::now() + self.deadline;
        self.write("", self.deadline, until).await
    }

    /// Sends a message and discards lines until one is recognised.
    async fn await_echo<T>(
        &mut self,
        message: &str,
        mut recognise: impl FnMut(&str) -> Option<T>,
    ) -> Result<T, LinkError> {
        let until = Instant::now() + self.deadline;
        self.write(message, self.deadline, until).await?;
        loop {
            match self.line(message, self.deadline, until).await {
                Ok(line) => {
                    if let Some(recognised) = recognise(&line) {
                        return Ok(recognised);
                    }
                }
                Err(LinkError::NotText { .. }) => {}
                Err(LinkError::TooLong { .. }) => self.received.clear(),
                Err(fault) => return Err(fault),
            }
        }
    }

    /// Marks the link synchronised if nothing was received after the last recognised line.
    pub(super) async fn confirm_synchronised(&mut self, message: &str) -> Result<(), LinkError> {
        self.read_available(message).await?;
        if !self.received.is_empty() {
            return Err(self.unsolicited());
        }
        self.state = State::Synchronised;
        Ok(())
    }

    /// A number from 1 to 255, different from the previous one.
    fn next_nonce(&mut self) -> u8 {
        self.nonce = self.nonce.wrapping_add(97).max(1);
        self.nonce
    }
}

/// Parses `12;34`; signs and blanks are allowed.
fn two_numbers(line: &str) -> Option<(u8, u8)> {
    let (one, other) = line.split_once(';')?;
    Some((one.trim().parse().ok()?, other.trim().parse().ok()?))
}
