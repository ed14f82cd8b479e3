//! The costs of the settings of a plan. The plan's dictionary has two keys for each setting.

use serde::Serialize;

use super::PlanDetails;

/// One cost of a plan: a setting compared with the plan without it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SettingCost {
    /// The name of the setting in options and configuration.
    pub setting: &'static str,
    /// Time added to a frame, s; negative if the setting saves time.
    pub seconds: f64,
    /// Noise of a reading without the setting divided by the noise with it.
    pub gain: f64,
}

/// Formats as `averages 9.0 s (noise / 2.00)`.
impl std::fmt::Display for SettingCost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = self.setting.replace('_', " ");
        let saves = if self.seconds < 0.0 { "saves " } else { "" };
        write!(f, "{name} {saves}")?;
        match self.seconds.abs() {
            short if short < 1.0 => write!(f, "{:.0} ms", 1e3 * short)?,
            seconds => write!(f, "{seconds:.1} s")?,
        }
        match self.gain {
            gain if (gain - 1.0).abs() < 1e-9 => Ok(()),
            gain if gain > 1.0 => write!(f, " (noise / {gain:.2})"),
            gain => write!(f, " (noise x {:.2})", 1.0 / gain),
        }
    }
}

impl PlanDetails {
    /// Setting, cost and gain of each setting that may add time to a frame.
    fn cost_fields(&mut self) -> [(&'static str, &mut Option<f64>, &mut Option<f64>); 9] {
        [
            ("nplc", &mut self.cost_nplc_s, &mut self.gain_nplc),
            (
                "averages",
                &mut self.cost_averages_s,
                &mut self.gain_averages,
            ),
            (
                "autozero",
                &mut self.cost_autozero_s,
                &mut self.gain_autozero,
            ),
            ("settle", &mut self.cost_settle_s, &mut self.gain_settle),
            (
                "channel_delay",
                &mut self.cost_channel_delay_s,
                &mut self.gain_channel_delay,
            ),
            (
                "reversal",
                &mut self.cost_reversal_s,
                &mut self.gain_reversal,
            ),
            (
                "zero_every",
                &mut self.cost_zero_every_s,
                &mut self.gain_zero_every,
            ),
            ("ranges", &mut self.cost_ranges_s, &mut self.gain_ranges),
            ("half", &mut self.cost_half_s, &mut self.gain_half),
        ]
    }

    /// The costs of all settings that are present.
    pub fn costs(&self) -> Vec<SettingCost> {
        let mut details = self.clone();
        let fields = details.cost_fields().into_iter();
        let costs = fields.filter_map(|(setting, seconds, gain)| {
            Some(SettingCost {
                setting,
                seconds: (*seconds)?,
                gain: (*gain)?,
            })
        });
        costs.collect()
    }

    /// Adds the cost of a setting; an unknown name is ignored.
    pub fn set_cost(&mut self, cost: SettingCost) {
        for (setting, seconds, gain) in self.cost_fields() {
            if setting == cost.setting {
                (*seconds, *gain) = (Some(cost.seconds), Some(cost.gain));
            }
        }
    }
}
