//! What the system says about a network interface.

use std::path::Path;

use ethtool::{EthtoolAttr, EthtoolCoalesceAttr, EthtoolError, EthtoolFeatureAttr, EthtoolHandle};
use smol::stream::{Stream, StreamExt};

use crate::checks::{Finding, text};

/// Everything about the interface. `root` is `/`.
pub(crate) fn look(root: &Path, name: &str) -> Vec<Finding> {
    let directory = root.join("sys/class/net").join(name);
    // Names of interfaces hold no slashes, and this program opens no other directory.
    if name.contains('/') || !directory.exists() {
        let change = format!("there is no interface `{name}`: `ip link` lists them");
        return vec![Finding::change("interface", "none", change)];
    }
    let mut findings = vec![
        kind(&directory),
        link(&directory, name),
        speed(&directory, name),
        addresses(root, name),
    ];
    findings.extend(driver(name));
    findings
}

fn kind(directory: &Path) -> Finding {
    let check = "interface";
    if directory.join("wireless").exists() {
        return Finding::change(check, "wireless", "EtherCAT needs a cable");
    }
    let driver = std::fs::read_link(directory.join("device/driver"));
    let driver = driver.ok().and_then(|path| {
        let name = path.file_name()?;
        Some(name.to_string_lossy().into_owned())
    });
    match driver {
        Some(driver) if driver.starts_with("usb") || driver.starts_with("r8152") => {
            Finding::change(
                check,
                driver,
                "a USB adapter answers by the USB's own millisecond frames: use one on PCI Express",
            )
        }
        Some(driver) => Finding::good(check, format!("driver {driver}")),
        None => Finding::unknown(check, "virtual, without a driver"),
    }
}

fn link(directory: &Path, name: &str) -> Finding {
    let check = "link";
    // Reading the carrier of an interface that is down is an error.
    match text(directory, "carrier").as_deref() {
        Some("1") => Finding::good(check, "up, with a carrier"),
        Some(_) => Finding::change(
            check,
            "no carrier",
            "plug the cable in, and switch the first device on",
        ),
        None => Finding::change(check, "down", format!("`ip link set {name} up`")),
    }
}

fn speed(directory: &Path, name: &str) -> Finding {
    let check = "speed";
    let speed = text(directory, "speed").unwrap_or_default();
    let duplex = text(directory, "duplex").unwrap_or_default();
    match (speed.as_str(), duplex.as_str()) {
        ("" | "-1", _) => Finding::unknown(check, "not told"),
        ("100", "full") => Finding::good(check, "100 Mbit/s, full duplex"),
        _ => Finding::change(
            check,
            format!("{speed} Mbit/s, {duplex} duplex"),
            format!(
                "EtherCAT runs at 100 Mbit/s, full duplex: is an EtherCAT device plugged into {name}?"
            ),
        ),
    }
}

/// Other programs use an interface that has addresses or routes.
fn addresses(root: &Path, name: &str) -> Finding {
    let check = "other traffic";
    let routes = text(root, "proc/net/route").unwrap_or_default();
    let ipv6 = text(root, "proc/net/if_inet6").unwrap_or_default();
    let first = |line: &&str| line.split_whitespace().next() == Some(name);
    let last = |line: &&str| line.split_whitespace().last() == Some(name);
    match (
        routes.lines().any(|line| first(&line)),
        ipv6.lines().any(|line| last(&line)),
    ) {
        (false, false) => Finding::good(check, "no addresses, no routes"),
        (routes, _) => Finding::change(
            check,
            if routes {
                "IP routes"
            } else {
                "an IPv6 address"
            },
            format!(
                "the system sends frames of its own among EtherCAT's: `ip addr flush dev {name}`, `sysctl -w \
                 net.ipv6.conf.{name}.disable_ipv6=1`, and leave it out of the network manager \
                 (`nmcli device set {name} managed no`)"
            ),
        ),
    }
}

/// What the driver says over the kernel's ethtool interface.
fn driver(name: &str) -> Vec<Finding> {
    let (offloads, coalescing) = ("offloads", "coalescing");
    let asked = || -> Result<_, Box<dyn std::error::Error>> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .build()?;
        Ok(runtime.block_on(ask(name))?)
    };
    let answer = match asked() {
        Ok(answer) => answer,
        Err(error) => return vec![Finding::unknown(offloads, error.to_string())],
    };
    vec![
        answer.active.map_or_else(
            || Finding::unknown(offloads, "the driver does not say"),
            |active| told_of_offloads(name, &active),
        ),
        answer.delay.map_or_else(
            || Finding::unknown(coalescing, "the driver does not say"),
            |delay| told_of_coalescing(name, &delay),
        ),
    ]
}

/// Offloads that hold received frames back until more have come, by the names of the kernel.
const HOLDING: [&str; 3] = ["rx-gro", "rx-lro", "rx-gro-hw"];

fn told_of_offloads(name: &str, active: &[String]) -> Finding {
    let check = "offloads";
    let held: Vec<_> = HOLDING
        .into_iter()
        .filter(|holding| active.iter().any(|on| on == holding))
        .collect();
    if held.is_empty() {
        return Finding::good(check, "received frames are handed on one by one");
    }
    let off: Vec<_> = held
        .iter()
        .map(|feature| format!("{feature} off"))
        .collect();
    Finding::change(
        check,
        held.join(", "),
        format!("`ethtool -K {name} {}`", off.join(" ")),
    )
}

/// What a driver waits for before it tells of a frame.
#[derive(Debug, Default)]
struct Delay {
    microseconds: u32,
    adaptive: bool,
}

fn told_of_coalescing(name: &str, delay: &Delay) -> Finding {
    let check = "coalescing";
    if delay.microseconds == 0 && !delay.adaptive {
        return Finding::good(check, "an interrupt for each frame");
    }
    let adaptive = if delay.adaptive { ", adaptive" } else { "" };
    Finding::change(
        check,
        format!("up to {} µs{adaptive}", delay.microseconds),
        format!("`ethtool -C {name} adaptive-rx off adaptive-tx off rx-usecs 0 tx-usecs 0`"),
    )
}

/// What a driver answers; none where it does not.
#[derive(Debug, Default)]
struct Answer {
    active: Option<Vec<String>>,
    delay: Option<Delay>,
}

async fn ask(name: &str) -> std::io::Result<Answer> {
    let (connection, mut handle, _) = ethtool::new_connection()?;
    tokio::spawn(connection);
    let mut answer = Answer::default();
    for attribute in features(&mut handle, name).await {
        if let EthtoolAttr::Feature(EthtoolFeatureAttr::Active(bits)) = attribute {
            let on = bits.into_iter().filter(|bit| bit.value).map(|bit| bit.name);
            answer.active = Some(on.collect());
        }
    }
    for attribute in coalescing(&mut handle, name).await {
        let EthtoolAttr::Coalesce(attribute) = attribute else {
            continue;
        };
        let delay = answer.delay.get_or_insert_default();
        match attribute {
            EthtoolCoalesceAttr::RxUsecs(time) | EthtoolCoalesceAttr::TxUsecs(time) => {
                delay.microseconds = delay.microseconds.max(time);
            }
            EthtoolCoalesceAttr::UseAdaptiveRx(on) | EthtoolCoalesceAttr::UseAdaptiveTx(on) => {
                delay.adaptive |= on;
            }
            _ => {}
        }
    }
    Ok(answer)
}

async fn features(handle: &mut EthtoolHandle, name: &str) -> Vec<EthtoolAttr> {
    match handle.feature().get(Some(name)).execute().await {
        Ok(messages) => attributes(messages).await,
        Err(_) => Vec::new(),
    }
}

async fn coalescing(handle: &mut EthtoolHandle, name: &str) -> Vec<EthtoolAttr> {
    match handle.coalesce().get(Some(name)).execute().await {
        Ok(messages) => attributes(messages).await,
        Err(_) => Vec::new(),
    }
}

/// A driver that does not support a question answers with an error, which is no answer.
async fn attributes(
    messages: impl Stream<
        Item = Result<netlink_packet_generic::GenlMessage<ethtool::EthtoolMessage>, EthtoolError>,
    >,
) -> Vec<EthtoolAttr> {
    let mut messages = std::pin::pin!(messages);
    let mut all = Vec::new();
    while let Some(Ok(message)) = messages.next().await {
        all.extend(message.payload.nlas);
    }
    all
}
