//! The command that reproduces the paper's Table I, grating lobes and figures, compared with an independent calculation.

use crate::binary::{done_json, files_below, json_file};
use serde_json::Value;

/// RMSE of L-L, L-NL and NL-NL by rows, computed with other programs from the same definitions.
const INDEPENDENT: [[f64; 3]; 4] =
    [[0.313, 0.334, 0.159], [0.214, 0.255, 0.135], [0.164, 0.189, 0.118], [0.142, 0.147, 0.094]];

/// The band in Hz, the extent in m and the printed RMSE of the table's rows.
const PRINTED: [(f64, f64, [f64; 3]); 4] = [
    (2_000.0, 0.5, [0.32, 0.32, 0.15]),
    (2_000.0, 1.0, [0.23, 0.25, 0.12]),
    (2_000.0, 2.0, [0.17, 0.19, 0.12]),
    (10_000.0, 2.0, [0.15, 0.14, 0.11]),
];

fn numbers(row: &Value) -> [f64; 3] {
    ["L-L", "L-NL", "NL-NL"].map(|name| row[name].as_f64().unwrap())
}

fn list(value: &Value) -> &[Value] {
    value.as_array().unwrap()
}

/// Table I as JSON, and the same with every image scaled to fit the truth best.
fn check_table(table: &Value, least_squares: &Value) {
    assert_eq!((list(table).len(), list(least_squares).len()), (4, 4));
    let mut above = [f64::INFINITY; 3];
    for (i, (row, scaled)) in list(table).iter().zip(list(least_squares)).enumerate() {
        let (rmse, scaled) = (numbers(row), numbers(scaled));
        let (bandwidth, extent, printed) = PRINTED[i];
        println!("{bandwidth:6} Hz, {extent} m: {rmse:.4?}");
        assert_eq!((row["bandwidth"].as_f64(), row["extent"].as_f64()), (Some(bandwidth), Some(extent)));
        assert_eq!(numbers(&row["paper"]), printed);
        for k in 0..3 {
            assert!((rmse[k] - INDEPENDENT[i][k]).abs() <= 0.003, "{row}: not {}", INDEPENDENT[i][k]);
            assert!(rmse[k] < above[k], "falls down the rows: {} below {}", rmse[k], above[k]);
            assert!((rmse[k] - printed[k]).abs() < 0.02, "the printed {}: {}", printed[k], rmse[k]);
            assert!(scaled[k] < rmse[k]);
        }
        let [l_l, l_nl, nl_nl] = rmse;
        assert!(nl_nl < l_l && nl_nl < l_nl, "NL-NL is best: {rmse:?}");
        assert!((1.3..2.2).contains(&(l_nl / nl_nl)), "the abstract's 1.3 to 2.1: {}", l_nl / nl_nl);
        let [l_l, l_nl, nl_nl] = scaled;
        assert!(nl_nl < l_l && nl_nl < l_nl, "best when scaled alike, too: {scaled:?}");
        above = rmse;
    }
}

/// Figure 7: where grating lobes appear, and where the classical rule predicts them.
fn check_aliasing(studies: &[Value]) {
    let counts: Vec<u64> = studies.iter().map(|study| study["microphones"].as_u64().unwrap()).collect();
    assert_eq!(counts, [15, 31, 63, 255]);
    let seen: Vec<bool> =
        studies.iter().map(|study| study["off_lines_db"].as_f64().unwrap() > -6.0).collect();
    assert_eq!(seen, [true, true, false, false], "15, 31, 63 and 255 microphones");
    for study in studies {
        let number = |grating_lobe: &Value, key: &str| grating_lobe[key].as_f64().unwrap();
        // Grating lobes beyond the array's end are farther away; those within it are where the rule predicts them.
        let within = list(&study["ghosts"])
            .iter()
            .filter(|grating_lobe| number(grating_lobe, "predicted_x").abs() < 1.2);
        for grating_lobe in within {
            let off = (number(grating_lobe, "predicted_x") - number(grating_lobe, "measured_x")).abs();
            assert!(off < 0.05 * number(study, "spacing").max(0.8), "{study}");
            assert!(
                (number(grating_lobe, "predicted_db") - number(grating_lobe, "measured_db")).abs() < 6.0,
                "{study}"
            );
        }
    }
    assert!(list(&studies[0]["ghosts"]).len() >= 3 && list(&studies[3]["ghosts"]).is_empty());
}

#[test]
fn the_paper_is_computed_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let made = done_json(folder.path(), "reproduce -o paper");
    check_table(&made["table1"], &made["least_squares"]);
    check_aliasing(list(&made["aliasing"]));
    let timings = list(&made["timings"]["methods"]);
    assert!(timings.len() >= 4 && timings.iter().all(|timing| timing["error"].as_f64().unwrap() < 1e-3));

    let written = files_below(&folder.path().join("paper"));
    assert_eq!((written.len(), list(&made["files"]).len()), (9, 9), "{written:?}");
    assert!(written.iter().all(|file| file.metadata().unwrap().len() > 100));
    assert_eq!(json_file(&folder.path().join("paper/table1.json")), made["table1"]);
}
