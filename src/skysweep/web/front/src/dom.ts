/** Elements. Text is always text: nothing that a mission says is read as markup. */

type Child = Node | string | null | undefined | false;
type Props = Record<string, unknown>;

/** An element with attributes (`onclick` and the like are listeners) and children. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value as EventListener);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  for (const child of children) if (child) element.append(child);
  return element;
}

/** Sets the text of an element where it differs: an unchanged one costs no layout. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * A canvas as large as it is shown, sharp on dense screens; asking for that size costs a layout, so small ones say it.
 *
 * It is drawn by the processor: thousands of short strokes take long on a graphics card that is only emulated.
 */
export function fitCanvas(
  canvas: HTMLCanvasElement,
  shownWidth = canvas.clientWidth,
  shownHeight = canvas.clientHeight,
): CanvasRenderingContext2D {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [Math.round(shownWidth * ratio), Math.round(shownHeight * ratio)];
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  const context = canvas.getContext("2d", { willReadFrequently: true })!;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

/** A button that stays pressed or not. */
export function toggle(label: string, title: string, pressed: boolean, changed: (on: boolean) => void): HTMLButtonElement {
  const button = h("button", { type: "button", title, "aria-pressed": pressed }, label);
  button.setAttribute("aria-pressed", String(pressed));
  button.addEventListener("click", () => {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    changed(on);
  });
  return button;
}
