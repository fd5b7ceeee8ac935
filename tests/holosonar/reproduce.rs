//! The paper's Table I, ghosts and figures, held to an independent calculation.

use holosonar::progress::Silent;
use holosonar::reproduce::{Aliasing, CASES, reproduce, row};

/// RMSE of L-L, L-NL and NL-NL by rows, computed with other programs from the same definitions.
const INDEPENDENT: [[f64; 3]; 4] =
    [[0.313, 0.334, 0.159], [0.214, 0.255, 0.135], [0.164, 0.189, 0.118], [0.142, 0.147, 0.094]];

#[test]
fn table_1_is_the_independent_one() {
    let mut above = [f64::INFINITY; 3];
    for (case, independent) in CASES.into_iter().zip(INDEPENDENT) {
        let row = row(case).unwrap();
        println!("{:6} Hz, {} m: {:.4?}", case.bandwidth, case.extent, row.rmse);
        for (i, (ours, other)) in row.rmse.iter().zip(independent).enumerate() {
            assert!((ours - other).abs() <= 0.003, "{case:?}: {ours} for {other}");
            assert!(*ours < above[i], "falls down the rows: {ours} below {}", above[i]);
            assert!((ours - case.paper[i]).abs() < 0.02, "the printed {}: {ours}", case.paper[i]);
            assert!(row.least_squares[i] < *ours);
        }
        let [l_l, l_nl, nl_nl] = row.rmse;
        assert!(nl_nl < l_l && nl_nl < l_nl, "NL-NL is best: {:?}", row.rmse);
        assert!((1.3..2.2).contains(&(l_nl / nl_nl)), "the abstract's 1.3 to 2.1: {}", l_nl / nl_nl);
        let [l_l, l_nl, nl_nl] = row.least_squares;
        assert!(nl_nl < l_l && nl_nl < l_nl, "best when scaled alike, too: {:?}", row.least_squares);
        above = row.rmse;
    }
}

#[test]
#[ignore = "times direct sums for some seconds"]
fn everything_is_computed_and_written() {
    let made = reproduce(&Silent).unwrap();
    let seen: Vec<bool> = made.aliasing.iter().map(Aliasing::shows_ghosts).collect();
    assert_eq!(seen, [true, true, false, false], "15, 31, 63 and 255 microphones");
    for study in &made.aliasing {
        // Ghosts beyond the array's end bend further away; those within it are where the rule puts them.
        let within = study.ghosts.iter().filter(|ghost| ghost.predicted_x.abs() < 1.2);
        for ghost in within {
            let off = (ghost.predicted_x - ghost.measured_x).abs();
            assert!(off < 0.05 * study.spacing.max(0.8), "{study:?}");
            assert!((ghost.predicted_db - ghost.measured_db).abs() < 6.0, "{study:?}");
        }
    }
    assert!(made.aliasing[0].ghosts.len() >= 3 && made.aliasing[3].ghosts.is_empty());
    assert!(made.timings.methods.iter().all(|timing| timing.error < 1e-3), "{:?}", made.timings);

    let folder = tempfile::tempdir().unwrap();
    let files = made.write(folder.path()).unwrap();
    assert_eq!(files.len(), 9);
    assert!(files.iter().all(|file| file.metadata().unwrap().len() > 100));
    let text = std::fs::read_to_string(folder.path().join("table1.json")).unwrap();
    let table: serde_json::Value = serde_json::from_str(&text).unwrap();
    for (row, case) in table.as_array().unwrap().iter().zip(CASES) {
        assert_eq!(row["bandwidth"], case.bandwidth);
        assert_eq!(row["extent"], case.extent);
        assert_eq!(row["paper"]["NL-NL"], case.paper[2]);
        assert!(row["L-L"].is_f64() && row["L-NL"].is_f64() && row["NL-NL"].is_f64());
    }
}
