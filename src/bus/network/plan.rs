//! What a program wants of its line, and which device of the line each declared one is.

use std::time::Duration;

use crate::bus::{
    device::{
        config::{DriveConfig, Watchdog},
        io::IoConfig,
    },
    error::{BringUpStep, NetworkError, SettingError},
    expected::{self, DevicePlace, Expected, Present},
    line::Found,
    network::scan::ALIAS,
    requests::Context,
};

/// The longest time after which a silent drive must count as lost: until then, nothing that waits for it resolves.
const LONGEST_LOSS: Duration = Duration::from_secs(60);

/// What the settings of times may be.
const CYCLES: [Duration; 2] = [Duration::from_micros(50), Duration::from_secs(1)];
const WATCHDOGS: [Duration; 2] = [Duration::from_micros(100), Duration::from_millis(6500)];
const DEADLINES: [Duration; 2] = [Duration::from_millis(1), Duration::from_secs(3600)];
const SETTLING: [Duration; 2] = [Duration::ZERO, Duration::from_secs(60)];

/// What the program wants of the line.
#[derive(Debug, Clone)]
pub(in crate::bus) struct LinePlan {
    pub(in crate::bus) cycle: Duration,
    pub(in crate::bus) drives: Vec<(DevicePlace, DriveConfig)>,
    pub(in crate::bus) ios: Vec<(DevicePlace, IoConfig)>,
    /// Devices that must be there and are left alone.
    pub(in crate::bus) others: Vec<(DevicePlace, Expected)>,
    /// No other devices may be there.
    pub(in crate::bus) complete: bool,
    pub(in crate::bus) watchdog: Watchdog,
}

impl LinePlan {
    /// What is wrong with the declaration itself.
    pub(in crate::bus) fn check(&self) -> Result<(), NetworkError> {
        let wrong = |text: String| Err(NetworkError::Declaration(text));
        if self.drives.is_empty() && self.ios.is_empty() {
            return wrong("no drive was declared".into());
        }
        let within = |of: &str, setting, got, [least, most]: [Duration; 2]| {
            if (least..=most).contains(&got) {
                return Ok(());
            }
            Err(NetworkError::Setting(SettingError {
                of: of.to_owned(),
                setting,
                got,
                least,
                most,
            }))
        };
        within("the network", "cycle", self.cycle, CYCLES)?;
        if let Watchdog::Armed(Some(time)) = self.watchdog {
            within("the network", "watchdog", time, WATCHDOGS)?;
        }
        let declared = self.declared();
        for (number, (place, _)) in declared.iter().enumerate() {
            if *place == DevicePlace::Alias(0) {
                return wrong("alias 0 is that of devices without one".into());
            }
            if declared
                .iter()
                .take(number)
                .any(|(other, _)| other == place)
            {
                return wrong(format!("two devices are declared at {place}"));
            }
        }
        for (number, (place, io)) in self.ios.iter().enumerate() {
            if let Some(mistake) = io.mistake() {
                return wrong(format!("io at {place}: {mistake}"));
            }
            let mut before = self.ios.iter().take(number);
            if before.any(|(_, other)| other.name == io.name) {
                return wrong(format!("two devices are named `{}`", io.name));
            }
        }
        let mut names = Vec::new();
        for (place, drive) in &self.drives {
            if let Some(mistake) = drive.mistake() {
                return wrong(format!("drive at {place}: {mistake}"));
            }
            if let Some(mistake) = drive.clock.and_then(|clock| clock.mistake(self.cycle)) {
                return wrong(format!("drive at {place}: {mistake}"));
            }
            for axis in &drive.axes {
                if names.contains(&&axis.name) {
                    return wrong(format!("two axes are named `{}`", axis.name));
                }
                names.push(&axis.name);
                let of = format!("axis `{}`", axis.name);
                for (setting, time) in axis.deadlines.each() {
                    within(&of, setting, time, DEADLINES)?;
                }
                if let Some(tolerances) = axis.tolerances {
                    within(&of, "settle time", tolerances.settle, SETTLING)?;
                }
                if let Some(loss) = axis.loss {
                    let longest = self
                        .cycle
                        .saturating_mul(loss.stale_cycles.max(loss.undelivered_cycles));
                    if loss.stale_cycles == 0
                        || loss.undelivered_cycles < loss.stale_cycles
                        || longest > LONGEST_LOSS
                    {
                        return wrong(format!(
                            "axis `{}`: {loss:?} at cycles of {:?} is not at least one stale cycle, at most as many as \
                             undelivered ones, and at most {LONGEST_LOSS:?}: nobody may wait longer for a silent drive",
                            axis.name, self.cycle
                        ));
                    }
                }
            }
        }
        Ok(())
    }

    /// All devices that must be there: the drives first, then those with inputs and outputs.
    fn declared(&self) -> Vec<(DevicePlace, Expected)> {
        let drives = self.drives.iter();
        let drives = drives.map(|(place, drive)| (*place, drive.expected()));
        let ios = self.ios.iter();
        let ios = ios.map(|(place, io)| (*place, io.expected.clone()));
        drives
            .chain(ios)
            .chain(self.others.iter().cloned())
            .collect()
    }

    /// Which device of the line each declared one is.
    pub(in crate::bus) async fn find(
        &self,
        context: &Context,
        line: &[Found],
    ) -> Result<Vec<Found>, NetworkError> {
        let declared = self.declared();
        let by_alias = |(place, _): &_| matches!(place, DevicePlace::Alias(_));
        let needs_alias = declared.iter().any(by_alias);
        let mut present = Vec::new();
        for found in line {
            let alias = if needs_alias {
                let alias = context.registers.read(found.station, ALIAS).await;
                let alias = alias
                    .map_err(|error| found.clone().fault(BringUpStep::Identity, error.into()))?;
                Some(u16::from_le_bytes(alias))
            } else {
                None
            };
            let id = found.id.clone();
            present.push(Present { id, alias });
        }
        let places = expected::compare(&declared, &present, self.complete)?;
        let found = places.into_iter().filter_map(|place| line.get(place));
        Ok(found.cloned().collect())
    }
}
