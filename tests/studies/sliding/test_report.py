from sliding_cases import (
    GAIN,
)

from kneexo.studies.sliding.report import report
from kneexo.studies.sliding.study import (
    LAWS,
)


def test_every_cell_of_the_report_is_in_its_case(study, tables, check_cells):
    motion, start, sampled = tables(report(study))

    def labels(case, plant="plant"):
        law = {"paper": "Eq. 27", "area": "Eq. 27 + area", "area_gain": "Eq. 27 + area, gain"}
        return {
            plant: case.plant,
            "load (N)": case.load_n,
            "k": law[case.law],
            "η (m/s³)": case.eta_m_s3,
        }

    def percent(case, **names):
        return {title: 100.0 * getattr(case.measured, name) for name, title in names.items()}

    def reaching(case):
        return {
            "reached after (ms)": 1e3 * case.measured.reaching_s,
            "promised (ms)": 1e3 * case.measured.promised_s,
            "outside again (%)": 100.0 * case.measured.left_share,
        }

    holds = "s·ds/dt ≤ −η¦s¦"
    check_cells(
        motion,
        [
            labels(case)
            | percent(
                case,
                outside_share="outside the layer (%)",
                holding_share=f"there {holds} (%)",
                attracting_share="there s·ds/dt < 0 (%)",
            )
            | {
                "largest ¦s¦/Φ": case.measured.largest_s,
                "largest error (mm)": case.measured.largest_error_mm,
                "run": "left the range of motion" if case.measured.failure else "complete",
            }
            for case in study.of("motion")
        ],
    )
    check_cells(
        start,
        [
            labels(case)
            | percent(case, holding_share=f"outside: {holds} (%)")
            | {"largest sgn(s)·ds/dt (m/s³)": case.measured.worst_rate_m_s3}
            | reaching(case)
            for case in study.of("start")
        ],
    )
    check_cells(
        sampled,
        [
            labels(case, "loop")
            | percent(
                case,
                holding_share=f"outside: {holds} (%) after an update",
                held_share="before the next",
                mean_share="on the mean",
            )
            | reaching(case)
            | {"largest error (mm)": case.measured.largest_error_mm}
            for case in study.of("sampled")
        ],
    )


def test_the_screen_has_the_findings(by_hand, check_screen):
    lines = check_screen(report(by_hand))
    assert any(line.startswith("On the full-order plant the paper's k") for line in lines[2:4])


def test_the_findings_have_the_numbers_of_the_results(by_hand):
    text = report(by_hand)
    full = [c for c in by_hand.cases if c.plant == "full"]
    shares = {
        name: [100.0 * c.measured.holding_share for c in full if c.law == name] for name in LAWS
    }
    for said in (
        "λ = 20 1/s, Φ = 3.2 m/s²",
        "Φ/λ² = 8 mm",
        "in 3 of 3 runs",
        "the paper's k suffices for η ≥ 20000 m/s³ with 60 N (with the area term for η ≥ 10000",
        "η ≥ 33000 m/s³",
        "η ≥ 81000 m/s³",
        # Default: 2.8e5 m/s³ times 2 ms over 3.2 m/s².
        "175 times Φ for the default",
        f"{GAIN['controller.mass_min_kg']:.2f}…{GAIN['controller.mass_max_kg']:.2f} kg in place "
        "of 1.4…1.8 kg",
        *(f" {min(s):.0f}…{max(s):.0f} % ({LAWS[n]})" for n, s in shares.items()),
    ):
        assert said in text
