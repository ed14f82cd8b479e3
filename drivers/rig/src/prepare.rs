//! Settings applied and read back, before a frame and after a rig has been lost.

use survey::{Plan, Sensing};

use crate::traits::Instruments;
use crate::{CurrentSource, MeterSettings, Rig, RigError, Voltmeter};

/// Applies the settings of a plan to source and voltmeter, each verified by read-back; the source stays off. The first
/// time after connecting the voltmeter's mainframe is reset.
///
/// # Errors
/// A setting that reads back differently, a refusal, or a wire that fails. The source is then off only if the error is
/// not the source's own.
pub async fn prepare<C, W, V>(
    rig: &Rig<C, W, V>,
    plan: &Plan,
    meter: MeterSettings,
) -> Result<(), RigError>
where
    C: CurrentSource,
    V: Voltmeter,
{
    apply(&mut *rig.lock().await, plan, meter).await
}

pub(crate) async fn apply<C, W, V>(
    rig: &mut Instruments<C, W, V>,
    plan: &Plan,
    meter: MeterSettings,
) -> Result<(), RigError>
where
    C: CurrentSource,
    V: Voltmeter,
{
    rig.source.prepare(plan.current, plan.compliance).await?;
    let scan = match plan.wiring.sensing {
        Sensing::Scan => plan.wiring.measuring_relays(),
        _ => Vec::new(),
    };
    rig.voltmeter.prepare(meter, &scan).await
}
