"use strict";
// Served, never written: a written page that draws its test views for who measures it (browser.py).
(async () => {
  const answer = async (head, ...parts) =>
    fetch("answer", { method: "POST", body: new Blob([JSON.stringify(head), "\n", ...parts]) });
  await ready;
  if (!official) { await answer({ error: byId("note").textContent || byId("message").textContent }); return; }
  await answer({ browser: navigator.userAgent, device: official.name, format: official.format });
  for (;;) {
    let asked;
    // Who told us what to draw has gone: end the browser with its only window.
    try { asked = await (await fetch("next")).json(); } catch { window.close(); return; }
    try {
      const begun = performance.now(), bytes = await pixelsOf(asked.test);
      await answer({ ms: performance.now() - begun }, bytes);
    } catch (error) { await answer({ error: String(error.message || error) }); }
  }
})();
