//! Applies and reads back settings, before a frame and after a lost connection.

use survey::Plan;

use crate::traits::Instruments;
use crate::{CurrentSource, MeterSettings, RigError, Switch, Voltmeter};

/// Applies the settings of a plan to source and voltmeter, each verified by read-back; the source stays off. After
/// connecting, the first call resets the voltmeter's mainframe. The switch is prepared for the longest wait.
///
/// # Errors
/// A setting that reads back differently, a rejected command, or a failed connection. The source is then off unless the
/// error is the source's.
pub async fn prepare<C, W, V>(
    rig: &mut Instruments<C, W, V>,
    plan: &Plan,
    meter: MeterSettings,
) -> Result<(), RigError>
where
    C: CurrentSource,
    W: Switch,
    V: Voltmeter,
{
    rig.source.prepare(plan.current, plan.compliance).await?;
    // the switch receives no message while an injection settles and is read, in both polarities
    let settle_and_read = plan.settle + meter.deadline.unwrap_or_default();
    let polarities = if plan.reversal { 2 } else { 1 };
    let longest = settle_and_read * polarities;
    rig.switch.prepare_for_silence(longest).await?;
    rig.voltmeter
        .prepare(meter, &plan.wiring.scanned_channels())
        .await
}
